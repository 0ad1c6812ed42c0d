"""Straight tool moves: where the tool goes, and whether it may."""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import GuardedMove, MoveTool, Retract
from fsw.dictionary.enums import Tool
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.newton import NewtonRoots, refine_roots
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, norm
from fsw.motion.compensation import Compensation
from fsw.motion.paths import Travel
from fsw.motion.plan import Plan, Refusal, over_limits, standing, worst_limit
from fsw.motion.plan_knots import plan_through

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
    line = from_here(config, joints, command.tool, compensation)
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    end_p_m, approach = compensation.target(
        config, joints, command.tool, np.array(command.end_p_RoTo_R_m), approach
    )
    line = replace(line, end_p_m=end_p_m, end_axis=approach)
    problem = _length_problem(config, line) or _direction_problem(config, line)
    if problem is not None:
        return Refusal(problem)
    return _planned(config, joints, line, config.params.motion.guarded_speed_m_s)


def plan_straight(
    config: Config, joints: JointEstimate, command: MoveTool, p_RoTo_R_m: Array, approach_R: Array
) -> Plan | Refusal:
    """A straight line to a place, while the tool turns evenly to look along an approach."""
    line = from_here(config, joints, command.tool, Compensation(command.backlash, command.deflection))
    line = replace(line, end_p_m=p_RoTo_R_m, end_axis=approach_R)
    problem = _length_problem(config, line)
    if problem is not None:
        return Refusal(problem)
    return _planned(config, joints, line, config.params.motion.retract_speed_m_s)


def plan_retract(config: Config, joints: JointEstimate, command: Retract) -> Plan | Refusal:
    """A straight line back along the tool's axis."""
    compensation = Compensation(command.backlash, command.deflection)
    line = from_here(config, joints, command.tool, compensation)
    line = replace(line, end_p_m=line.p_m - command.distance_m * line.axis)
    problem = _length_problem(config, line)
    if problem is not None:
        return Refusal(problem)
    return _planned(config, joints, line, config.params.motion.retract_speed_m_s)


def from_here(config: Config, joints: JointEstimate, tool: Tool, compensation: Compensation) -> Line:
    """A line that has yet to go anywhere, so that its plan begins without a step."""
    gravity = compensation.gravity(joints)
    output = joints.motor_rad + compensation.allowance(joints, standing(joints).gear_rad)
    X_RT = tool_pose(config.arm, settle_output(config.arm, output, gravity).frames, tool)
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
    motion = config.params.motion
    travel = Travel(line.length_m, speed_m_s, motion.line_acceleration_m_s2, motion.line_jerk_m_s3)
    return plan_through(config, joints, found.output_rad, found.torque_Nm, line.compensation, travel)


def _followed(config: Config, line: Line, share: Array) -> NewtonRoots:
    """Outputs at each share (k,) of the line: all at once, or knot by knot where that loses the branch."""
    p_m = line.p_m[:, None] + share * (line.end_p_m - line.p_m)[:, None]
    axes = line.axis[:, None] + share * (line.end_axis - line.axis)[:, None]
    axes /= norm(axes)
    start = np.tile(line.output_rad[:, None], share.size)
    found = refine_roots(config.arm, line.tool, p_m, axes, line.gravity_R_m_s2, start)
    steps = np.abs(np.diff(found.output_rad, prepend=line.output_rad[:, None]))
    if np.all(found.converged) and steps.max() < KNOT_RAD:
        return found
    knots: list[NewtonRoots] = []
    last = before = line.output_rad
    for k in range(share.size):
        knot = refine_roots(
            config.arm, line.tool, p_m[:, k], axes[:, k], line.gravity_R_m_s2, 2 * last - before
        )
        followed = knot.converged & (np.abs(knot.output_rad - last).max() < KNOT_RAD)
        knots.append(replace(knot, converged=followed))
        before, last = last, knot.output_rad
    return NewtonRoots(
        output_rad=np.stack([knot.output_rad for knot in knots], axis=-1),
        torque_Nm=np.stack([knot.torque_Nm for knot in knots], axis=-1),
        error=np.stack([knot.error for knot in knots]),
        converged=np.stack([knot.converged for knot in knots]),
    )
