"""Plans of tool moves: joint moves to an inverse-kinematics branch, and straight lines."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.dictionary.commands import ROVER, GuardedMove, MoveTool, Retract
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import AUTO, cycle_record
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import Frames, tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import (
    BranchVerdict,
    IkResult,
    IkSearch,
    begin_search,
    describe_slot,
    find_regular_approach,
)
from fsw.kinematics.roots import NewtonRoots, NewtonSearch, begin_newton
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, concatenate_records, norm, select_targets
from fsw.motion.paths import Travel
from fsw.motion.plan import (
    Compensation,
    KnotPlan,
    Plan,
    PosePlan,
    Refusal,
    describe_worst_limit,
    likely_positions,
    plan_over_knots,
    plan_poses,
    worst_limit_excess,
)
from fsw.motion.work import Work

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

    def targets(self, share: Array) -> tuple[Array, Array]:
        """Compute positions and unit axes in RMECH, (3, k) each, at shares (k,) of the line."""
        p_m = self.p_m[:, None] + share * (self.end_p_m - self.p_m)[:, None]
        axes = self.axis[:, None] + share * (self.end_axis - self.axis)[:, None]
        return p_m, axes / norm(axes)


ITERATIONS: Final = 2
"""Iterations of the inverse kinematics in a piece of work: each takes some 0.5 ms."""


@cycle_record
class BranchSearch(Work[tuple[Branch, ...] | Refusal]):
    """Search of the valid branches of a joint move to a target, the fastest first.

    A branch is valid if the target and the end of the straight travel after it are within limits. Relative
    compensation uses the present deflection of the reference tool.
    """

    joints: JointEstimate
    command: MoveTool
    reference: str
    targets: tuple[Array, Array] | None = None
    """Positions and approaches of the target and of the end of the travel after it, (3, 2) each."""
    search: IkSearch | IkResult | None = None
    """Search of all branches; None before it has begun."""

    def advance(self, config: Config) -> "BranchSearch | tuple[Branch, ...] | Refusal":
        """Do some iterations of the search; after the last one, choose the branches."""
        targets = self.targets or self._find_targets(config)
        search = self.search or self._begin(config, targets)
        for _ in range(ITERATIONS):
            if isinstance(search, IkSearch):
                search = search.advance()
        if isinstance(search, IkSearch):
            return replace(self, targets=targets, search=search)
        return self._choose(config, *targets, search)

    def _find_targets(self, config: Config) -> tuple[Array, Array]:
        travel_m = np.array([0.0, self.command.line_m])
        return _target(config, self.joints, self.command, self.reference, travel_m)

    def _begin(self, config: Config, targets: tuple[Array, Array]) -> IkSearch | IkResult:
        tool, gravity = self.command.tool, self.compensation.gravity(self.joints)
        return begin_search(config.arm, tool, *targets, gravity, self.joints.motor_rad)

    @property
    def compensation(self) -> Compensation:
        """Return the compensations of the move."""
        return Compensation(self.command.backlash, self.command.deflection)

    def _choose(
        self, config: Config, targets: Array, approaches: Array, result: IkResult
    ) -> tuple[Branch, ...] | Refusal:
        valid = np.all(result.verdict == BranchVerdict.VALID, axis=-1)
        wanted = np.array([self.command.branch in (AUTO, name) for name in BRANCHES])
        if not np.any(valid & wanted):
            return Refusal(_explain_refusal(config, self.command.tool, targets, approaches, result, wanted))
        output = np.where(valid & wanted, result.output_rad[..., 0], np.nan)
        turn_rad = np.abs(output - self.joints.output_rad[:, None])
        duration_s = np.max(turn_rad / config.speed_rad_s[:, None], axis=0)
        fastest = np.argsort(duration_s, kind="stable")[: np.count_nonzero(valid & wanted)]
        return tuple(Branch(BRANCHES[slot], output[:, slot], float(duration_s[slot])) for slot in fastest)


@cycle_record
class BranchMove(Work[Plan | Refusal]):
    """Plan of a joint move to a target on the fastest branch that is asked for."""

    branches: BranchSearch

    def advance(self, config: Config) -> "BranchMove | PosePlan | Refusal":
        """Search the branches; then the joint move to the first of them is planned."""
        found = self.branches.advance(config)
        if isinstance(found, BranchSearch):
            return BranchMove(found)
        if isinstance(found, Refusal):
            return found
        joints, compensation = self.branches.joints, self.branches.compensation
        return plan_poses(joints, [found[0].output_rad], compensation, found[0].name)


def plan_tool(
    config: Config, joints: JointEstimate, command: MoveTool, reference: str
) -> Work[Plan | Refusal] | Refusal:
    """Begin the plan of a move to a target: straight, or a joint move to a branch.

    Relative compensation uses the present deflection of the reference tool.
    """
    if command.straight:
        return _plan_straight(config, joints, command, reference)
    return BranchMove(BranchSearch(joints, command, reference))


def _target(
    config: Config, joints: JointEstimate, command: MoveTool, reference: str, travel_m: Array
) -> tuple[Array, Array]:
    """Return positions and approaches at distances (k,) beyond the target, shape (3, k) each."""
    compensation = Compensation(command.backlash, command.deflection)
    p_m, approach = np.array(command.p_FoTo_F_m), np.array(command.approach_F)
    if command.frame != ROVER:
        frames = settle_output(config.arm, joints.output_rad, compensation.gravity(joints)).frames
        X_RF = _frame_pose(config, frames, command.frame)
        p_m, approach = X_RF.R @ p_m + X_RF.p, X_RF.R @ approach
    approach = approach / np.linalg.norm(approach)
    ahead = p_m[:, None] + approach[:, None] * travel_m
    return compensation.target(config, joints, reference, ahead, np.tile(approach[:, None], travel_m.size))


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


@cycle_record
class LineSearch(Work[Plan | Refusal]):
    """Search of the outputs at the knots of a line, of all of them at once; plans over these knots follow.

    If one of the knots leaves the branch, each is searched from the ones before it.
    """

    joints: JointEstimate
    line: Line
    speed_m_s: float
    share: Array
    """Shares of the line at its knots, (k,)."""
    search: NewtonSearch | NewtonRoots | None = None

    def advance(self, config: Config) -> "LineSearch | KnotSearch | KnotPlan | Refusal":
        """Take a Newton step at all knots; after the last one, begin the plan over the knots."""
        search = self.search
        if search is None:
            start = np.tile(self.line.output_rad[:, None], self.share.size)
            search = begin_newton(
                config.arm, self.line.tool, *self.line.targets(self.share), self.line.gravity_R_m_s2, start
            )
        if isinstance(search, NewtonSearch):
            search = search.advance()
        if isinstance(search, NewtonSearch):
            return replace(self, search=search)
        turns = np.abs(np.diff(search.output_rad, prepend=self.line.output_rad[:, None]))
        if np.all(search.converged) and turns.max() < MAX_KNOT_STEP_RAD:
            return plan_over_roots(config, self, search)
        return KnotSearch(self, (self.line.output_rad, self.line.output_rad))


@cycle_record
class KnotSearch(Work[Plan | Refusal]):
    """Search of the outputs at the knots of a line, one after the other."""

    along: LineSearch
    last_two_rad: tuple[Array, Array]
    """Outputs at the last two knots, (5,) each."""
    found: tuple[NewtonRoots, ...] = ()
    search: NewtonSearch | NewtonRoots | None = None
    """Search of the next knot; None before it has begun."""

    def advance(self, config: Config) -> "KnotSearch | KnotPlan | Refusal":
        """Take a Newton step at a knot; after the last knot, begin the plan over the knots."""
        line, share = self.along.line, self.along.share
        before, last = self.last_two_rad
        k = len(self.found)
        search = self.search
        if search is None:
            p_m, axis = line.targets(share[k : k + 1])
            start = (2 * last - before)[:, None]
            search = begin_newton(config.arm, line.tool, p_m, axis, line.gravity_R_m_s2, start)
        if isinstance(search, NewtonSearch):
            search = search.advance()
        if isinstance(search, NewtonSearch):
            return replace(self, search=search)
        output = search.output_rad[:, 0]
        stays = search.converged & (np.abs(output - last).max() < MAX_KNOT_STEP_RAD)
        found = (*self.found, replace(search, converged=stays))
        if stays.all() and len(found) < share.size:
            return KnotSearch(self.along, (last, output), found)
        return plan_over_roots(config, self.along, concatenate_records(found))


def plan_over_roots(config: Config, along: LineSearch, roots: NewtonRoots) -> KnotPlan | Refusal:
    """Begin the plan over the knots of a line, or refuse the first one that the arm cannot have.

    Args:
        roots: Outputs of the knots up to the first that is not found, batch (n,).
    """
    line, motion = along.line, config.params.motion
    excess = worst_limit_excess(config, roots.output_rad)
    if not np.all(roots.converged):
        reached_m = along.share[np.argmin(roots.converged)] * line.length_m
        return Refusal(f"the straight move leaves the reach of the arm after {reached_m:.3f} m")
    if np.any(excess > 0):
        k = int(np.argmax(excess > 0))
        along_m = along.share[k] * line.length_m
        return Refusal(
            f"{along_m:.3f} m along the line, {describe_worst_limit(config, roots.output_rad[:, k])}"
        )
    travel = Travel(line.length_m, along.speed_m_s, motion.line_acceleration_m_s2, motion.line_jerk_m_s3)
    return plan_over_knots(config, along.joints, roots.output_rad, roots.torque_Nm, line.compensation, travel)


def plan_guarded(config: Config, joints: JointEstimate, command: GuardedMove) -> LineSearch | Refusal:
    """Begin the plan of a guarded move: a straight line along the tool axis to the end of the move."""
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
    config: Config, joints: JointEstimate, command: MoveTool, reference: str
) -> LineSearch | Refusal:
    """Begin the plan of a straight line to a target, while the tool turns evenly to its approach."""
    line = start_line(config, joints, command.tool, Compensation(command.backlash, command.deflection))
    p_m, approach = _target(config, joints, command, reference, np.zeros(1))
    line = replace(line, end_p_m=p_m[:, 0], end_axis=approach[:, 0])
    return _plan_line(config, joints, line, config.params.motion.guarded_speed_m_s)


def plan_retract(config: Config, joints: JointEstimate, command: Retract) -> LineSearch | Refusal:
    """Begin the plan of a straight line back along the tool axis."""
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


def _plan_line(config: Config, joints: JointEstimate, line: Line, speed_m_s: float) -> LineSearch | Refusal:
    """Begin the plan of the paths along a line, within the reach and the soft limits of the arm."""
    problem = _check_line_length(config, line)
    if problem is not None:
        return Refusal(problem)
    knots = int(np.ceil(line.length_m / config.params.motion.line_step_m)) + 1
    return LineSearch(joints, line, speed_m_s, np.linspace(0.0, 1.0, knots))
