"""Straight tool moves: where the tool goes, whether it may, and the joint paths that take it there."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import GuardedMove, Retract
from fsw.dictionary.joints import Tool
from fsw.estimate.gear import STILL_RAD, bounds_under, gear_moved
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.refine import Refined, refine
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array, norm
from fsw.motion.compensation import Compensation
from fsw.motion.paths import Path, joint_path, line_path
from fsw.motion.plan import Plan, Refusal, Stand, over_limits, standing, worst_limit

KNOT_RAD = 0.2
"""A joint that moves more than this between two knots has not stayed on its branch."""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A straight tool move, from the pose that the motor angles have under the plan's assumptions."""

    tool: Tool
    compensation: Compensation
    gravity_R_m_s2: Array
    output_rad: Array
    """At the start."""
    p_m: Array
    axis: Array
    """Where the tool looks at the start."""
    end_p_m: Array
    end_axis: Array

    @property
    def length_m(self) -> float:
        """From start to end."""
        return float(np.linalg.norm(self.end_p_m - self.p_m))


def plan_guarded(config: Config, joints: JointEstimate, command: GuardedMove) -> Plan | Refusal:
    """A straight line from where the tool stands to the end of the guarded travel, the way the tool looks."""
    compensation = Compensation(command.backlash, command.deflection)
    line = _from_here(config, joints, command.tool, compensation)
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    end_p_m, approach = compensation.target(
        config, joints, command.tool, np.array(command.end_p_RoTo_R_m), approach
    )
    line = replace(line, end_p_m=end_p_m, end_axis=approach)
    problem = _length_problem(config, line) or _direction_problem(config, line)
    if problem is not None:
        return Refusal(problem)
    return _planned(config, joints, line, config.params.motion.guarded_speed_m_s)


def plan_retract(config: Config, joints: JointEstimate, command: Retract) -> Plan | Refusal:
    """A straight line back along the tool's axis."""
    compensation = Compensation(command.backlash, command.deflection)
    line = _from_here(config, joints, command.tool, compensation)
    line = replace(line, end_p_m=line.p_m - command.distance_m * line.axis)
    problem = _length_problem(config, line)
    if problem is not None:
        return Refusal(problem)
    return _planned(config, joints, line, config.params.motion.retract_speed_m_s)


def _from_here(config: Config, joints: JointEstimate, tool: Tool, compensation: Compensation) -> Line:
    """A line that has yet to go anywhere, so that its plan begins without a step."""
    gravity = compensation.gravity(joints)
    output = joints.motor_rad + compensation.allowance(joints, standing(joints).gear_rad)
    X_RT = tool_pose(config.arm, rest(config.arm, output, gravity).frames, tool)
    axis = X_RT.R[:, 0]
    return Line(tool, compensation, gravity, output, X_RT.p, axis, X_RT.p, axis)


def _length_problem(config: Config, line: Line) -> str | None:
    longest = config.params.motion.line_max_m
    if line.length_m < 1e-6:
        return "the straight move has no length"
    if line.length_m > longest:
        return f"the straight move is {line.length_m:.3g} m long, the longest allowed is {longest} m"
    return None


def _direction_problem(config: Config, line: Line) -> str | None:
    """A guarded move goes where its tool looks: elsewhere its contact switch would not be what touches."""
    most = config.params.motion.line_turn_rad
    for name, direction in (("the approach", line.end_axis), ("the way to the end", line.end_p_m - line.p_m)):
        off = float(np.arccos(np.clip(line.axis @ direction / np.linalg.norm(direction), -1.0, 1.0)))
        if off > most:
            return (
                f"{name} is {np.degrees(off):.1f} deg from where the tool looks, "
                f"at most {np.degrees(most):.1f} deg are allowed"
            )
    return None


def _planned(config: Config, joints: JointEstimate, line: Line, speed_m_s: float) -> Plan | Refusal:
    share = np.linspace(0.0, 1.0, int(np.ceil(line.length_m / config.params.motion.line_step_m)) + 1)
    found = _followed(config, line, share)
    over = over_limits(config, found.output_rad)
    if not np.all(found.converged):
        reached_m = share[np.argmin(found.converged)] * line.length_m
        return Refusal(f"the straight move leaves the reach of the arm after {reached_m:.3f} m")
    if np.any(over > 0):
        k = int(np.argmax(over > 0))
        along_m = share[k] * line.length_m
        return Refusal(f"{along_m:.3f} m along the line, {worst_limit(config, found.output_rad[:, k])}")
    return _paths_along(config, joints, line, found, speed_m_s)


def _followed(config: Config, line: Line, share: Array) -> Refined:
    """Outputs at each share (k,) of the line: all at once, or knot by knot where that loses the branch."""
    p_m = line.p_m[:, None] + share * (line.end_p_m - line.p_m)[:, None]
    axes = line.axis[:, None] + share * (line.end_axis - line.axis)[:, None]
    axes /= norm(axes)
    start = np.tile(line.output_rad[:, None], share.size)
    found = refine(config.arm, line.tool, p_m, axes, line.gravity_R_m_s2, start)
    steps = np.abs(np.diff(found.output_rad, prepend=line.output_rad[:, None]))
    if np.all(found.converged) and steps.max() < KNOT_RAD:
        return found
    knots: list[Refined] = []
    last = before = line.output_rad
    for k in range(share.size):
        knot = refine(config.arm, line.tool, p_m[:, k], axes[:, k], line.gravity_R_m_s2, 2 * last - before)
        followed = knot.converged & (np.abs(knot.output_rad - last).max() < KNOT_RAD)
        knots.append(replace(knot, converged=followed))
        before, last = last, knot.output_rad
    return Refined(
        output_rad=np.stack([knot.output_rad for knot in knots], axis=-1),
        torque_Nm=np.stack([knot.torque_Nm for knot in knots], axis=-1),
        error=np.stack([knot.error for knot in knots]),
        converged=np.stack([knot.converged for knot in knots]),
    )


def _paths_along(config: Config, joints: JointEstimate, line: Line, found: Refined, speed_m_s: float) -> Plan:
    """Lines over the knots; where a gear is to be crossed first, a joint move while the tool stands still."""
    step_m = line.length_m / (found.output_rad.shape[1] - 1)
    loads_Nm = rest(config.arm, found.output_rad, joints.gravity_R_m_s2).torque_Nm
    stiffness, compensation = config.arm.gear_stiffness_Nm_rad, line.compensation
    here = standing(joints)
    paths: list[Path] = []
    gear, knots = here.gear_rad, [here.motor_rad]
    for k, moved in enumerate(np.diff(found.output_rad).T, start=1):
        bounds = bounds_under(config, joints.reference.half_gap_rad, loads_Nm[:, k])
        wound = (loads_Nm[:, k] - loads_Nm[:, k - 1]) / stiffness
        new_gear = gear_moved(gear + wound, moved, bounds)
        allowance = compensation.allowance(joints, new_gear)
        crossed = allowance - compensation.allowance(joints, gear + wound)
        if np.abs(crossed).max() > STILL_RAD:
            if len(knots) > 1:
                paths.append(line_path(config, np.array(knots), step_m * (len(knots) - 1), speed_m_s))
            paths.append(joint_path(config, knots[-1], knots[-1] - crossed))
            knots = [knots[-1] - crossed]
        gear = new_gear
        knots.append(found.output_rad[:, k] - allowance)
    paths.append(line_path(config, np.array(knots), step_m * (len(knots) - 1), speed_m_s))
    return Plan(tuple(paths), Stand(knots[-1], gear), compensation.gap(joints, gear))
