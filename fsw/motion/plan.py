"""From a tool target to motor angles: branch choice, compensation, straight lines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.dictionary.commands import Deflection, GuardedMove, MoveTool, Retract
from fsw.dictionary.joints import Joint, Tool
from fsw.estimate.joints import JointEstimate, gap_to_move
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.compensation import Compensated, refine
from fsw.kinematics.ik import BRANCHES, Verdict, closed_form, into_limits
from fsw.kinematics.statics import Equilibrium, settle
from fsw.kinematics.transforms import Array

AUTO = "AUTO"


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a target cannot be reached."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class ToolPlan:
    """Motor angles for a tool target, and the branch they are on."""

    motor_rad: Array
    branch: str


@dataclass(frozen=True, slots=True, eq=False)
class LinePlan:
    """Motor knots (k, 5) at equal spacing along a straight tool move."""

    motor_rad: Array
    length_m: float


def plan_tool(config: Config, joints: JointEstimate, command: MoveTool) -> ToolPlan | Refusal:
    """Motor angles for the quickest valid branch from where the joints are, or for the named one.

    A branch is valid if the target and the end of the straight travel after it are within limits.
    """
    tool, start_rad = command.tool, joints.motor_rad
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    targets = np.array(command.p_RoTo_R_m) + np.array([[0.0], [command.line_m]]) * approach
    rigid = closed_form(config.arm, tool, targets, np.broadcast_to(approach, (2, 3)))
    found = refine(
        config.arm,
        tool,
        targets[:, None, :],
        np.broadcast_to(approach, (2, 1, 3)),
        _gravity(joints, command.deflection),
        rigid.output_rad,
    )
    output = into_limits(config.arm, found.output_rad, start_rad)
    motor = _motor(config, joints, found, output, output - start_rad - joints.gap_rad)
    over = _over_limits(config, output)
    valid = np.all(found.converged & (over <= 0), axis=0)
    wanted = np.array([command.branch in (AUTO, name) for name in BRANCHES])
    if not np.any(valid & wanted):
        return Refusal(_why_none(tool, rigid.verdict, rigid.excess, over, output, config))
    travel_s = np.max(np.abs(motor[0] - start_rad) / config.speed_rad_s, axis=-1)
    best = int(np.argmin(np.where(valid & wanted, travel_s, np.inf)))
    return ToolPlan(motor[0, best], BRANCHES[best])


def plan_guarded(config: Config, joints: JointEstimate, command: GuardedMove) -> LinePlan | Refusal:
    """A straight line from where the tool stands to the end of the guarded travel."""
    here, X_RT = _stand(config, joints, command.tool, command.deflection)
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    end = np.array(command.end_p_RoTo_R_m)
    return _plan_line(config, joints, command.tool, command.deflection, here, X_RT, end, approach)


def plan_retract(config: Config, joints: JointEstimate, command: Retract) -> LinePlan | Refusal:
    """A straight line back along the tool's axis."""
    here, X_RT = _stand(config, joints, command.tool, command.deflection)
    axis = X_RT[:3, 0]
    end = X_RT[:3, 3] - command.distance_m * axis
    return _plan_line(config, joints, command.tool, command.deflection, here, X_RT, end, axis)


def _stand(
    config: Config, joints: JointEstimate, tool: Tool, deflection: Deflection
) -> tuple[Equilibrium, Array]:
    """How the arm stands under the assumptions of a plan, so that a line from there begins without a step."""
    here = settle(config.arm, joints.motor_rad, joints.gap_rad, _gravity(joints, deflection))
    return here, tool_pose(config.arm, here.frames, tool)


def _plan_line(
    config: Config,
    joints: JointEstimate,
    tool: Tool,
    deflection: Deflection,
    here: Equilibrium,
    X_RT: Array,
    end: Array,
    end_axis: Array,
) -> LinePlan | Refusal:
    start, axis = X_RT[:3, 3], X_RT[:3, 0]
    length = float(np.linalg.norm(end - start))
    knots = int(np.ceil(length / config.params.motion.line_step_m)) + 1
    if knots < 2:
        return Refusal("the straight move has no length")
    share = np.linspace(0.0, 1.0, knots)[:, None]
    axes = (1 - share) * axis + share * end_axis
    found = refine(
        config.arm,
        tool,
        start + share * (end - start),
        axes / np.linalg.norm(axes, axis=-1, keepdims=True),
        _gravity(joints, deflection),
        np.broadcast_to(here.output_rad, (knots, 5)),
    )
    if not np.all(found.converged):
        return Refusal(
            "the straight move leaves the reach of the arm after "
            f"{share[np.argmin(found.converged), 0] * length:.3f} m"
        )
    over = _over_limits(config, found.output_rad)
    if np.any(over > 0):
        k = int(np.argmax(over > 0))
        return Refusal(
            f"{share[k, 0] * length:.3f} m along the line {_worst_limit(config, found.output_rad[k])}"
        )
    return LinePlan(_motor_knots(config, joints, found), length)


def _motor_knots(config: Config, joints: JointEstimate, found: Compensated) -> Array:
    """Motor angles from where the motors are, each knot with the gap of the motion that leads to it."""
    motion = np.diff(found.output_rad, axis=0)
    motor = np.empty_like(found.output_rad)
    motor[0], gap = joints.motor_rad, joints.gap_rad
    for k in range(1, len(motor)):
        gap = gap_to_move(config, found.torque_Nm[k], gap, motion[k - 1])
        motor[k] = found.output_rad[k] - found.torque_Nm[k] / config.arm.gear_stiffness_Nm_rad - gap
    return motor


def _gravity(joints: JointEstimate, deflection: Deflection) -> Array:
    return joints.gravity_R_m_s2 if deflection == "absolute" else np.zeros(3)


def _motor(
    config: Config, joints: JointEstimate, found: Compensated, output: Array, motion_rad: Array
) -> Array:
    """Motor angles under output angles: less the wind-up and less the gap as it will be after the motion."""
    gap = gap_to_move(config, found.torque_Nm, joints.gap_rad, motion_rad)
    motor: Array = output - found.torque_Nm / config.arm.gear_stiffness_Nm_rad - gap
    return motor


def _over_limits(config: Config, output: Array) -> Array:
    arm = config.arm
    over: Array = np.max(np.maximum(arm.soft_min_rad - output, output - arm.soft_max_rad), axis=-1)
    return over


def _worst_limit(config: Config, output: Array) -> str:
    low, high = config.arm.soft_min_rad, config.arm.soft_max_rad
    joint = Joint(int(np.argmax(np.maximum(low - output, output - high))))
    limit = low[joint] if output[joint] < low[joint] else high[joint]
    at_deg, limit_deg = np.degrees(output[joint]), np.degrees(limit)
    return f"{joint.name.lower()} at {at_deg:.1f} deg is beyond its soft limit {limit_deg:.1f} deg"


def _why_none(
    tool: Tool, verdict: NDArray[np.int64], excess: Array, over: Array, output: Array, config: Config
) -> str:
    """The reason of the branch that comes nearest, at the target if it fails there, else on the line."""
    for place, name in ((0, "the target"), (1, "the end of the approach")):
        if np.all(verdict[place] == Verdict.OUT_OF_REACH):
            return f"{tool.name}: {name} is out of reach by {excess[place].min():.3f} m on every branch"
        reachable = np.where(np.isfinite(over[place]), over[place], np.inf)
        if np.all(reachable > 0):
            k = int(np.argmin(reachable))
            return (
                f"{tool.name}: {name}, nearest branch {BRANCHES[k]}: {_worst_limit(config, output[place, k])}"
            )
    return f"{tool.name}: no branch reaches the target and the end of the approach alike"
