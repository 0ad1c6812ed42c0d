"""Plans of tool moves: joint moves to an inverse-kinematics branch, and straight lines."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsw.collision.geometry import TargetSurface
from fsw.config import Config
from fsw.dictionary.commands import ROVER, GuardedMove, MoveTool, Retract
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import AUTO
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import Frames, tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import (
    BranchVerdict,
    IkResult,
    describe_slot,
    find_regular_approach,
    inverse_kinematics,
)
from fsw.kinematics.roots import NewtonRoots, refine_roots
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, norm, select_targets
from fsw.motion.paths import Travel, check_paths
from fsw.motion.plan import (
    Compensation,
    Plan,
    Refusal,
    describe_worst_limit,
    likely_positions,
    plan_joint_move,
    plan_over_knots,
    worst_limit_excess,
)

MAX_KNOT_STEP_RAD = 0.2
"""Largest turn of a joint between two knots that stay on one branch."""


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """Branch of the inverse kinematics at a target."""

    name: str
    output_rad: Array
    """Outputs at the target, (5,)."""
    least_s: float
    """Lower bound of the duration of a move there."""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Straight tool move; it starts at the modelled pose of the motor angles."""

    tool: str
    compensation: Compensation
    gravity_R_m_s2: Array
    """Gravity that deflects the modelled arm, (3,); zero if deflection is not compensated."""
    output_rad: Array
    """Outputs at the start, (5,)."""
    p_m: Array
    """Position of the tool at the start in RMECH, (3,)."""
    axis: Array
    """Direction of the tool axis at the start in RMECH, (3,)."""
    end_p_m: Array
    end_axis: Array

    @property
    def length_m(self) -> float:
        """Return the distance from start to end."""
        return float(np.linalg.norm(self.end_p_m - self.p_m))


def plan_tool(
    config: Config,
    joints: JointEstimate,
    command: MoveTool,
    reference: str | None = None,
    surface: TargetSurface | None = None,
) -> Plan | Refusal:
    """Plan a move to a target: straight, or a joint move to the fastest valid branch with a clear path.

    A branch is valid if the target and the end of the straight travel after it are within limits. Relative
    compensation uses the present deflection of the reference tool; None is that of the command.
    """
    if command.straight:
        plan = _plan_straight(config, joints, command, reference)
        return plan if isinstance(plan, Refusal) else _refuse_blocked(config, joints, plan, surface)
    branches = find_branches(config, joints, command, reference)
    if isinstance(branches, Refusal):
        return branches
    refusals = []
    for branch in branches:
        pose = branch.output_rad
        load_Nm = settle_output(config.arm, pose, joints.gravity_R_m_s2).torque_Nm
        compensation = Compensation(command.backlash, command.deflection)
        move = plan_joint_move(config, joints, likely_positions(joints), pose, load_Nm, compensation)
        plan = _refuse_blocked(config, joints, move, surface)
        if not isinstance(plan, Refusal):
            return replace(plan, branch=branch.name)
        refusals.append(replace(plan, reason=f"{command.tool}: {branch.name}: {plan.reason}"))
    return refusals[0]


def find_branches(
    config: Config, joints: JointEstimate, command: MoveTool, reference: str | None = None
) -> list[Branch] | Refusal:
    """Find the valid branches of a joint move to a target, as `plan_tool` has them, the fastest first."""
    compensation = Compensation(command.backlash, command.deflection)
    targets, approaches = _target(config, joints, command, reference, np.array([0.0, command.line_m]))
    result = inverse_kinematics(
        config.arm, command.tool, targets, approaches, compensation.gravity(joints), joints.motor_rad
    )
    valid = np.all(result.verdict == BranchVerdict.VALID, axis=-1)
    wanted = np.array([command.branch in (AUTO, name) for name in BRANCHES])
    if not np.any(valid & wanted):
        return Refusal(_explain_refusal(config, command.tool, targets, approaches, result, wanted))
    output = np.where(valid & wanted, result.output_rad[..., 0], np.nan)
    duration_s = np.max(np.abs(output - joints.output_rad[:, None]) / config.speed_rad_s[:, None], axis=0)
    fastest = np.argsort(duration_s, kind="stable")[: np.count_nonzero(valid & wanted)]
    return [Branch(BRANCHES[slot], output[:, slot], float(duration_s[slot])) for slot in fastest]


def _refuse_blocked(
    config: Config, joints: JointEstimate, plan: Plan, surface: TargetSurface | None
) -> Plan | Refusal:
    """Return the plan, or a refusal if its paths are not clear."""
    collision = check_paths(config, joints, plan.paths, config.params.collision.padding_m, surface=surface)
    return plan if collision is None else Refusal(collision, is_blocked=True)


def _target(
    config: Config, joints: JointEstimate, command: MoveTool, reference: str | None, travel_m: Array
) -> tuple[Array, Array]:
    """Return positions and approaches at distances (k,) beyond the target, shape (3, k) each."""
    compensation = Compensation(command.backlash, command.deflection)
    p_m, approach = np.array(command.p_FoTo_F_m), np.array(command.approach_F)
    if command.frame != ROVER:
        frames = settle_output(config.arm, joints.output_rad, compensation.gravity(joints)).frames
        X_RF = _frame_pose(config, frames, command.frame)
        p_m, approach = X_RF.R @ p_m + X_RF.p, X_RF.R @ approach
    approach = approach / np.linalg.norm(approach)
    tool = command.tool if reference is None else reference
    ahead = p_m[:, None] + approach[:, None] * travel_m
    return compensation.target(config, joints, tool, ahead, np.tile(approach[:, None], travel_m.size))


def _frame_pose(config: Config, frames: Frames, name: str) -> Pose:
    """Return the pose of an arm frame or a tool in RMECH by its name."""
    if name in config.arm.X_FT:
        return tool_pose(config.arm, frames, name)
    k = Frame[name.upper()]
    return Pose(frames.X_RF.R[:, :, k], frames.X_RF.p[:, k])


def _explain_refusal(
    config: Config, tool: str, targets: Array, approaches: Array, result: IkResult, wanted: NDArray[np.bool_]
) -> str:
    """Explain why no wanted branch is valid: the reason of the nearest one, at the target or after it."""
    for k, name in enumerate(("the target", "the end of the approach")):
        verdict, excess = result.verdict[:, k], result.excess[:, k]
        if not np.any(wanted & (verdict == BranchVerdict.VALID)):
            # by verdict first (a limit is nearer than the reach), then by excess
            nearest = int(np.lexsort((excess, verdict, ~wanted))[0])
            reason = f"{tool}: {name}: {describe_slot(config.arm, select_targets(result, k), nearest)}"
            if (verdict[nearest], result.joint[nearest, k]) != (BranchVerdict.SINGULAR, Joint.WRIST):
                return reason
            x, y, z = find_regular_approach(config.arm, tool, targets[:, k], approaches[:, k], nearest)
            return f"{reason}; the nearest regular approach in RMECH is {x:.3f} {y:.3f} {z:.3f}"
    return f"{tool}: no branch asked for reaches the target and the end of the approach alike"


def plan_guarded(config: Config, joints: JointEstimate, command: GuardedMove) -> Plan | Refusal:
    """Plan a guarded move: a straight line along the tool axis, from the present position to the end."""
    compensation = Compensation(command.backlash, command.deflection)
    line = start_line(config, joints, command.tool, compensation)
    approach = np.array(command.approach_R) / np.linalg.norm(command.approach_R)
    end_p_m, approach = compensation.target(
        config, joints, command.tool, np.array(command.end_p_RoTo_R_m), approach
    )
    line = replace(line, end_p_m=end_p_m, end_axis=approach)
    problem = _check_line_length(config, line) or _check_line_direction(config, line)
    if problem is not None:
        return Refusal(problem)
    return _plan_line(config, joints, line, config.params.motion.guarded_speed_m_s)


def _plan_straight(
    config: Config, joints: JointEstimate, command: MoveTool, reference: str | None
) -> Plan | Refusal:
    """Plan a straight line to a target, while the tool turns evenly to its approach."""
    line = start_line(config, joints, command.tool, Compensation(command.backlash, command.deflection))
    p_m, approach = _target(config, joints, command, reference, np.zeros(1))
    line = replace(line, end_p_m=p_m[:, 0], end_axis=approach[:, 0])
    return _plan_line(config, joints, line, config.params.motion.guarded_speed_m_s)


def plan_retract(config: Config, joints: JointEstimate, command: Retract) -> Plan | Refusal:
    """Plan a straight line back along the tool axis."""
    compensation = Compensation(command.backlash, command.deflection)
    line = start_line(config, joints, command.tool, compensation)
    line = replace(line, end_p_m=line.p_m - command.distance_m * line.axis)
    return _plan_line(config, joints, line, config.params.motion.retract_speed_m_s)


def start_line(config: Config, joints: JointEstimate, tool: str, compensation: Compensation) -> Line:
    """Build a line of no length at the modelled pose of a tool.

    A line that starts there begins at the present set-points, without a step.
    """
    gravity = compensation.gravity(joints)
    output = joints.motor_rad + compensation.allowance(joints, likely_positions(joints).gear_rad)
    X_RT = tool_pose(config.arm, settle_output(config.arm, output, gravity).frames, tool)
    axis = X_RT.R[:, 0]
    return Line(tool, compensation, gravity, output, X_RT.p, axis, X_RT.p, axis)


def _check_line_length(config: Config, line: Line) -> str | None:
    longest = config.params.motion.line_max_m
    if line.length_m < 1e-6:
        return "the straight move has no length"
    if line.length_m > longest:
        return f"the straight move is {line.length_m:.3g} m long, the longest allowed is {longest} m"
    return None


def _check_line_direction(config: Config, line: Line) -> str | None:
    """Check that a guarded move is along the tool axis, so that the contact switch touches first."""
    most_rad = config.params.motion.line_turn_rad
    for name, direction in (("the approach", line.end_axis), ("the way to the end", line.end_p_m - line.p_m)):
        angle_rad = float(np.arccos(np.clip(line.axis @ direction / np.linalg.norm(direction), -1.0, 1.0)))
        if angle_rad > most_rad:
            return (
                f"{name} is {np.degrees(angle_rad):.1f} deg from where the tool looks, "
                f"at most {np.degrees(most_rad):.1f} deg are allowed"
            )
    return None


def _plan_line(config: Config, joints: JointEstimate, line: Line, speed_m_s: float) -> Plan | Refusal:
    """Plan the paths along a line, within the reach and the soft limits of the arm."""
    problem = _check_line_length(config, line)
    if problem is not None:
        return Refusal(problem)
    share = np.linspace(0.0, 1.0, int(np.ceil(line.length_m / config.params.motion.line_step_m)) + 1)
    roots = _follow_line(config, line, share)
    excess = worst_limit_excess(config, roots.output_rad)
    if not np.all(roots.converged):
        reached_m = share[np.argmin(roots.converged)] * line.length_m
        return Refusal(f"the straight move leaves the reach of the arm after {reached_m:.3f} m")
    if np.any(excess > 0):
        k = int(np.argmax(excess > 0))
        along_m = share[k] * line.length_m
        return Refusal(
            f"{along_m:.3f} m along the line, {describe_worst_limit(config, roots.output_rad[:, k])}"
        )
    motion = config.params.motion
    travel = Travel(line.length_m, speed_m_s, motion.line_acceleration_m_s2, motion.line_jerk_m_s3)
    return plan_over_knots(config, joints, roots.output_rad, roots.torque_Nm, line.compensation, travel)


def _follow_line(config: Config, line: Line, share: Array) -> NewtonRoots:
    """Find the outputs at shares (k,) of the line.

    All knots are solved at once. If one of them leaves the branch, each is solved from the ones before it.
    """
    p_m = line.p_m[:, None] + share * (line.end_p_m - line.p_m)[:, None]
    axes = line.axis[:, None] + share * (line.end_axis - line.axis)[:, None]
    axes /= norm(axes)
    start = np.tile(line.output_rad[:, None], share.size)
    roots = refine_roots(config.arm, line.tool, p_m, axes, line.gravity_R_m_s2, start)
    steps = np.abs(np.diff(roots.output_rad, prepend=line.output_rad[:, None]))
    if np.all(roots.converged) and steps.max() < MAX_KNOT_STEP_RAD:
        return roots
    knots: list[NewtonRoots] = []
    last = before = line.output_rad
    for k in range(share.size):
        knot = refine_roots(
            config.arm, line.tool, p_m[:, k], axes[:, k], line.gravity_R_m_s2, 2 * last - before
        )
        stays = knot.converged & (np.abs(knot.output_rad - last).max() < MAX_KNOT_STEP_RAD)
        knots.append(replace(knot, converged=stays))
        before, last = last, knot.output_rad
    return NewtonRoots(
        output_rad=np.stack([knot.output_rad for knot in knots], axis=-1),
        torque_Nm=np.stack([knot.torque_Nm for knot in knots], axis=-1),
        error=np.stack([knot.error for knot in knots]),
        converged=np.stack([knot.converged for knot in knots]),
    )
