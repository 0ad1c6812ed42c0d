"""From a tool target to a plan: branch choice, compensation, straight lines."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.dictionary.commands import Deflection, GuardedMove, MoveTool, Retract
from fsw.dictionary.joints import Tool
from fsw.estimate.joints import JointEstimate, gap_to_move
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.compensation import Compensated, refine
from fsw.kinematics.ik import BRANCHES, Branches, Verdict, closed_form, into_limits
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import Array
from fsw.motion.paths import joint_path, line_path
from fsw.motion.plan import Plan, Refusal, motor_under, over_limits, worst_limit

AUTO = "AUTO"


def plan_tool(config: Config, joints: JointEstimate, command: MoveTool) -> Plan | Refusal:
    """A joint move to the quickest valid branch from where the joints are, or to the named one.

    A branch is valid if the target and the end of the straight travel after it are within limits.
    """
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    targets = np.array(command.p_RoTo_R_m) + np.array([[0.0], [command.line_m]]) * approach
    rigid = closed_form(config.arm, command.tool, targets, np.broadcast_to(approach, (2, 3)))
    found = refine(
        config.arm,
        command.tool,
        targets[:, None, :],
        np.broadcast_to(approach, (2, 1, 3)),
        _gravity(joints, command.deflection),
        rigid.output_rad,
    )
    output = into_limits(config.arm, found.output_rad, joints.motor_rad)
    over = over_limits(config, output)
    valid = np.all(found.converged & (over <= 0), axis=0)
    wanted = np.array([command.branch in (AUTO, name) for name in BRANCHES])
    if not np.any(valid & wanted):
        return Refusal(_why_none(config, command.tool, rigid, over, output))
    torque = found.torque_Nm[0]
    gap = gap_to_move(config, torque, joints.gap_rad, output[0] - joints.motor_rad - joints.gap_rad)
    motor = motor_under(config, output[0], torque, gap)
    travel_s = np.max(np.abs(motor - joints.motor_rad) / config.speed_rad_s, axis=-1)
    best = int(np.argmin(np.where(valid & wanted, travel_s, np.inf)))
    path = joint_path(config, joints.motor_rad, motor[best])
    return Plan((path,), motor[best], gap[best], BRANCHES[best])


def plan_guarded(config: Config, joints: JointEstimate, command: GuardedMove) -> Plan | Refusal:
    """A straight line from where the tool stands to the end of the guarded travel."""
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    end = np.array(command.end_p_RoTo_R_m)
    speed = config.params.motion.guarded_speed_m_s
    return _plan_line(config, joints, command.tool, command.deflection, speed, lambda _: (end, approach))


def plan_retract(config: Config, joints: JointEstimate, command: Retract) -> Plan | Refusal:
    """A straight line back along the tool's axis."""

    def back(X_RT: Array) -> tuple[Array, Array]:
        return X_RT[:3, 3] - command.distance_m * X_RT[:3, 0], X_RT[:3, 0]

    speed = config.params.motion.retract_speed_m_s
    return _plan_line(config, joints, command.tool, command.deflection, speed, back)


def _plan_line(
    config: Config,
    joints: JointEstimate,
    tool: Tool,
    deflection: Deflection,
    speed_m_s: float,
    end_from: Callable[[Array], tuple[Array, Array]],
) -> Plan | Refusal:
    """A straight line to the position and axis that `end_from` gives for the pose in which the tool stands.

    The tool stands where the present motor angles put it under the plan's own assumptions, so that the line
    begins without a step.
    """
    gravity = _gravity(joints, deflection)
    here = settle(config.arm, joints.motor_rad, joints.gap_rad, gravity)
    X_RT = tool_pose(config.arm, here.frames, tool)
    start, axis = X_RT[:3, 3], X_RT[:3, 0]
    end, end_axis = end_from(X_RT)
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
        gravity,
        np.broadcast_to(here.output_rad, (knots, 5)),
    )
    over = over_limits(config, found.output_rad)
    if not np.all(found.converged):
        reached_m = share[np.argmin(found.converged), 0] * length
        return Refusal(f"the straight move leaves the reach of the arm after {reached_m:.3f} m")
    if np.any(over > 0):
        k = int(np.argmax(over > 0))
        return Refusal(
            f"{share[k, 0] * length:.3f} m along the line, {worst_limit(config, found.output_rad[k])}"
        )
    motor, gap = _motor_knots(config, joints, found)
    return Plan((line_path(config, motor, length, speed_m_s),), motor[-1], gap)


def _motor_knots(config: Config, joints: JointEstimate, found: Compensated) -> tuple[Array, Array]:
    """Motor angles from where the motors are, each knot with the gap of the motion to it; the last gap."""
    motion = np.diff(found.output_rad, axis=0)
    motor = np.empty_like(found.output_rad)
    motor[0], gap = joints.motor_rad, joints.gap_rad
    for k in range(1, len(motor)):
        gap = gap_to_move(config, found.torque_Nm[k], gap, motion[k - 1])
        motor[k] = motor_under(config, found.output_rad[k], found.torque_Nm[k], gap)
    return motor, gap


def _gravity(joints: JointEstimate, deflection: Deflection) -> Array:
    return joints.gravity_R_m_s2 if deflection == "absolute" else np.zeros(3)


def _why_none(config: Config, tool: Tool, rigid: Branches, over: Array, output: Array) -> str:
    """The reason of the branch that comes nearest, at the target if it fails there, else on the line."""
    for place, name in ((0, "the target"), (1, "the end of the approach")):
        if np.all(rigid.verdict[place] == Verdict.OUT_OF_REACH):
            return f"{tool.name}: {name} is out of reach by {rigid.excess[place].min():.3f} m on every branch"
        reachable: NDArray[np.float64] = np.where(np.isfinite(over[place]), over[place], np.inf)
        if np.all(reachable > 0):
            k = int(np.argmin(reachable))
            return (
                f"{tool.name}: {name}, nearest branch {BRANCHES[k]}: {worst_limit(config, output[place, k])}"
            )
    return f"{tool.name}: no branch reaches the target and the end of the approach alike"
