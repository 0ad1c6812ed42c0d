"""Planning of commands: the moves of a command, planned one after the other, on the way that is best.

A command is planned in pieces (`motion/work.py`). Where several ways lead to what it asks for, such as the
branches of the inverse kinematics, they are tried in turn. A way has steps; each begins where the step before
it ends. A step is planned, and then its paths are checked for collisions with rover, ground and surface.
"""

from dataclasses import dataclass, replace
from typing import Final, assert_never

import numpy as np

from fsw.collision.distance import limit_surface
from fsw.collision.geometry import TargetSurface
from fsw.config import Config
from fsw.dictionary.commands import (
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Process,
    Retract,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import AUTO, cycle_record, joints5
from fsw.estimate.joints import JointEstimate
from fsw.executive.context import check_arguments
from fsw.executive.expansion import CompoundCommand, ExpandedCommand, expand_command, locate_surface
from fsw.executive.poses import GravityPoseSearch, find_gravity_pose
from fsw.motion.clearance import PathCheck, TouchCheck, check_paths, check_touch, compute_deflected_frames
from fsw.motion.plan import Compensation, Plan, Refusal, estimate_at, plan_joint, plan_poses
from fsw.motion.plan_tool import Branch, BranchSearch, plan_guarded, plan_retract, plan_tool
from fsw.motion.work import Work
from fsw.state import Hold, SequenceStep

SingleMoveCommand = Unstow | Stow | MoveJoint | MoveJoints | MoveTool | GuardedMove | Retract
MotionCommand = SingleMoveCommand | CompoundCommand

FARTHER_M: Final = (0.0, 0.1, 0.25, 0.4)
"""Distances from the standoff to a way point, or of a retraction before a move, in the order of trial."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """State of the arm at the start of a plan."""

    joints: JointEstimate
    tool: str
    """Tool of the last tool command."""
    surface: TargetSurface | None
    """Surface to keep away from, see `locate_surface`."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSequence:
    """Single commands that do what a command asks for, with the plan of each that moves."""

    commands: tuple[SequenceStep, ...]
    plans: tuple[Plan, ...]
    end: Start
    """State of the arm at the end."""

    @property
    def duration_s(self) -> float:
        """Return the duration of all paths, without brakes and settling."""
        return sum(path.duration_s for plan in self.plans for path in plan.paths)


def plan_command(start: Start, command: MotionCommand) -> Work[PlannedSequence | Refusal]:
    """Begin the planning of a command."""
    match command:
        case PlaceTool() | ToolChange() | MoveTeachPoint(straight=False):
            return BranchedPlanning(start, command)
        case MoveTool(straight=False, branch=branch) if branch == AUTO:
            return BranchedPlanning(start, command)
        case Process():
            return ProcessPlanning(start, command, find_gravity_pose(start.joints, command))
        case Stow() | MoveTool() if start.surface is not None:
            return Search(start, command, tuple(Way(command, back_m=back_m) for back_m in FARTHER_M))
        case _:
            return Search(start, command, (Way(command),))


@cycle_record
class ProcessPlanning(Work[PlannedSequence | Refusal]):
    """Planning of a process, whose pose is searched first."""

    start: Start
    command: Process
    pose: GravityPoseSearch

    def advance(self, config: Config) -> "ProcessPlanning | WayPlan | Refusal":
        """Search the pose; then the move to it is planned."""
        pose = self.pose.advance(config)
        if isinstance(pose, GravityPoseSearch):
            return replace(self, pose=pose)
        if isinstance(pose, Refusal):
            return pose
        command = self.command
        tilt = MoveJoints(joints5(pose), command.backlash, command.deflection)
        return begin_way(self.start, (tilt, Hold(command.duration_s, command.vibrate)))


@dataclass(frozen=True, slots=True)
class Way:
    """One of the ways to do what a command asks for."""

    command: SingleMoveCommand | ExpandedCommand
    """Command with the branch of this way."""
    farther_m: float = 0.0
    """Distance from the standoff to a way point farther from the surface; 0 for none."""
    back_m: float = 0.0
    """Retraction before the command; 0 for none."""
    least_s: float = 0.0
    """Lower bound of the duration."""


@cycle_record
class BranchedPlanning(Work[PlannedSequence | Refusal]):
    """Planning of a command that may be done on several branches, which are searched first."""

    start: Start
    command: PlaceTool | ToolChange | MoveTool | MoveTeachPoint
    branches: BranchSearch | None = None
    """Search of the branches at the end of the first move; None before it has begun."""

    def advance(self, config: Config) -> "BranchedPlanning | Search | Refusal":
        """Search the branches; then the ways on them are tried, the fastest branch first."""
        branches = self._begin(config) if self.branches is None else self.branches
        if isinstance(branches, Refusal):
            return branches
        found = branches.advance(config)
        if isinstance(found, BranchSearch):
            return replace(self, branches=found)
        if isinstance(found, Refusal):
            return found
        return Search(self.start, self.command, self._list_ways(branches.command, found))

    def _begin(self, config: Config) -> BranchSearch | Refusal:
        start, command = self.start, self.command
        if isinstance(command, MoveTool):
            return BranchSearch(start.joints, command, start.tool)
        steps = expand_command(config, start.joints, start.tool, command, start.surface)
        if isinstance(steps, Refusal):
            return steps
        first = next(step for step in steps if isinstance(step, MoveTool))
        return BranchSearch(start.joints, first, start.tool)

    def _list_ways(self, first: MoveTool, branches: tuple[Branch, ...]) -> tuple[Way, ...]:
        """List the ways in the order of trial."""
        if isinstance(self.command, PlaceTool | ToolChange):
            return tuple(
                Way(replace(self.command, branch=branch.name), farther_m=farther_m, least_s=branch.least_s)
                for branch in branches
                for farther_m in FARTHER_M
            )
        return tuple(
            Way(replace(first, branch=branch.name), back_m=back_m)
            for back_m in (FARTHER_M[:1] if self.start.surface is None else FARTHER_M)
            for branch in branches
        )


@cycle_record
class Search(Work[PlannedSequence | Refusal]):
    """Search of the way of a command: the first that is clear; of a placement, the fastest one.

    On each branch, a placement leads from as little farther away as is clear. A stow may begin with a
    retraction. The refusal of another move names a retraction that would help.
    """

    start: Start
    command: MotionCommand
    ways: tuple[Way, ...]
    """Ways that are left; the first of them is being planned."""
    plan: "WayPlan | None" = None
    """Plan of the first way; None before it has begun."""
    fastest: PlannedSequence | None = None
    refusals: tuple[Refusal, ...] = ()
    """Reasons against other ways."""

    def advance(self, config: Config) -> "Search | PlannedSequence | Refusal":
        """Plan on along the first way; at its end, choose it or go on to the next one."""
        plan = self._begin(config) if self.plan is None else self.plan
        planned = plan if isinstance(plan, Refusal) else plan.advance(config)
        if isinstance(planned, WayPlan):
            return replace(self, plan=planned)
        way, left = self.ways[0], self.ways[1:]
        if isinstance(planned, Refusal):
            if not planned.is_blocked:  # a retraction helps only where something is in the way
                left = tuple(other for other in left if other.back_m == 0)
            return self._go_on(left, self.fastest, (*self.refusals, planned))
        if not isinstance(way.command, PlaceTool | ToolChange):
            if way.back_m == 0 or isinstance(way.command, Stow):
                return planned
            return Refusal(f"{self.refusals[0].reason}; clear after a retraction of {way.back_m:g} m")
        fastest = planned
        if self.fastest is not None and self.fastest.duration_s <= planned.duration_s:
            fastest = self.fastest
        others = (other for other in left if _branch(other) != _branch(way))
        faster = tuple(other for other in others if other.least_s < fastest.duration_s)
        return self._go_on(faster, fastest, self.refusals)

    def _begin(self, config: Config) -> "WayPlan | Refusal":
        way, start = self.ways[0], self.start
        if isinstance(way.command, SingleMoveCommand):
            back = (Retract(start.tool, way.back_m),) if way.back_m else ()
            return begin_way(start, (*back, way.command))
        steps = expand_command(config, start.joints, start.tool, way.command, start.surface, way.farther_m)
        return steps if isinstance(steps, Refusal) else begin_way(start, steps)

    def _go_on(
        self, ways: tuple[Way, ...], fastest: PlannedSequence | None, refusals: tuple[Refusal, ...]
    ) -> "Search | PlannedSequence | Refusal":
        if ways:
            return Search(self.start, self.command, ways, None, fastest, refusals)
        if fastest is not None:
            return fastest
        command, first = self.command, refusals[0]
        if not isinstance(command, PlaceTool | ToolChange) or not first.is_blocked:
            return first
        most_m = command.standoff_m + FARTHER_M[-1]
        which = "no" if command.branch == AUTO else f"on branch {command.branch}, no"
        return Refusal(f"{first.reason}; {which} way from up to {most_m:.2g} m above the surface is clear")


def _branch(way: Way) -> str:
    return way.command.branch if isinstance(way.command, PlaceTool | ToolChange) else AUTO


@cycle_record
class WayPlan(Work[PlannedSequence | Refusal]):
    """Plan of single commands, each from the end of the one before it."""

    commands: tuple[SequenceStep, ...]
    number: int
    """Index of the command that is being planned."""
    now: Start
    """State of the arm before this command."""
    plans: tuple[Plan, ...] = ()
    """Plans of the commands before it."""
    step: Work[Plan | Refusal] | None = None
    """Work of planning it; None before it has begun."""

    def advance(self, config: Config) -> "WayPlan | PlannedSequence | Refusal":
        """Plan on along the present command; at its end, go on to the next one that moves."""
        command = self.commands[self.number]
        if not isinstance(command, SingleMoveCommand):
            return self._go_on(self.plans, self.now)
        if self.step is None:
            return self._begin(config, command)
        plan = self.step.advance(config)
        if isinstance(plan, Work):
            return replace(self, step=plan)
        if isinstance(plan, Refusal):
            return plan
        tool = command.tool if isinstance(command, MoveTool | GuardedMove | Retract) else self.now.tool
        end = Start(estimate_at(self.now.joints, plan.end), tool, self.now.surface)
        return self._go_on((*self.plans, plan), end)

    def _begin(self, config: Config, command: SingleMoveCommand) -> "WayPlan | Refusal":
        now = self.now
        problem = check_arguments(config.params, command)
        if problem is not None:
            return Refusal(problem)
        surface = locate_surface(config, now.joints, now.tool, command, now.surface)
        step = plan_step(config, replace(now, surface=surface), command)
        if isinstance(step, Refusal):
            return step
        return replace(self, now=replace(now, surface=surface), step=step)

    def _go_on(self, plans: tuple[Plan, ...], end: Start) -> "WayPlan | PlannedSequence":
        if self.number + 1 < len(self.commands):
            return WayPlan(self.commands, self.number + 1, end, plans)
        return PlannedSequence(self.commands, plans, end)


def begin_way(start: Start, commands: tuple[SequenceStep, ...]) -> WayPlan:
    """Begin the plan of single commands."""
    return WayPlan(commands, 0, start)


@cycle_record
class StepPlan(Work[Plan | Refusal]):
    """Plan of the move of a single command, and the checks of its paths."""

    start: Start
    command: SingleMoveCommand
    motion: Work[Plan | Refusal] | Plan
    """Plan of the move, or the work of making it."""
    checks: tuple[PathCheck | TouchCheck, ...] = ()
    """Checks that are left."""

    def advance(self, config: Config) -> "StepPlan | Plan | Refusal":
        """Plan the move, then check it."""
        if isinstance(self.motion, Work):
            planned = self.motion.advance(config)
            if isinstance(planned, Refusal):
                return planned
            checks = self._list_checks(config, planned) if isinstance(planned, Plan) else ()
            return replace(self, motion=planned, checks=checks)
        check, *left = self.checks
        found = check.advance(config)
        if isinstance(found, PathCheck | TouchCheck):
            return replace(self, checks=(found, *left))
        if found is not None:
            branch = self.motion.branch
            where = (
                f"{self.command.tool}: {branch}: " if branch and isinstance(self.command, MoveTool) else ""
            )
            return Refusal(f"{where}{found}", is_blocked=True)
        return replace(self, checks=tuple(left)) if left else self.motion

    def _list_checks(self, config: Config, plan: Plan) -> tuple[PathCheck | TouchCheck, ...]:
        joints, surface, padding_m = self.start.joints, self.start.surface, config.params.collision.padding_m
        match self.command:
            case GuardedMove(tool=touching):
                check = check_paths(joints, plan.paths, padding_m, touching)
                if surface is None:
                    return (check,)
                return check, check_touch(config, joints, plan.paths, touching, surface.normal_R)
            case Stow() if surface is not None:
                # the arm has been in its ready pose since it was unstowed
                ready_rad = np.array(config.params.poses.ready_rad)[:, None]
                ready = compute_deflected_frames(config, joints, ready_rad)
                surface = limit_surface(config.collision_geometry, ready, surface)
                return (check_paths(joints, plan.paths, padding_m, surface=surface),)
            case Retract(tool=touching):
                return (check_paths(joints, plan.paths, padding_m, touching, surface),)
            case _:
                return (check_paths(joints, plan.paths, padding_m, surface=surface),)


def plan_step(config: Config, start: Start, command: SingleMoveCommand) -> StepPlan | Refusal:
    """Begin the plan of a single command."""
    motion = _plan_motion(config, start.joints, start.tool, command)
    return motion if isinstance(motion, Refusal) else StepPlan(start, command, motion)


def _plan_motion(
    config: Config, joints: JointEstimate, tool: str, command: SingleMoveCommand
) -> Work[Plan | Refusal] | Refusal:
    match command:
        case Unstow():
            poses = config.params.poses
            forth = [np.array(pose) for pose in (*poses.unstow_via_rad, poses.ready_rad)]
            return plan_poses(joints, forth, Compensation())
        case Stow():
            poses = config.params.poses
            back = (poses.ready_rad, *reversed(poses.unstow_via_rad), poses.stowed_rad)
            return plan_poses(joints, [np.array(pose) for pose in back], Compensation())
        case MoveJoint():
            compensation = Compensation(command.backlash)
            return plan_joint(joints, Joint(command.joint), command.angle_rad, compensation)
        case MoveJoints():
            pose = np.array(command.angle_rad) + (joints.output_rad if command.relative else 0.0)
            return plan_poses(joints, [pose], Compensation(command.backlash, command.deflection))
        case MoveTool():
            return plan_tool(config, joints, command, tool)
        case GuardedMove():
            return plan_guarded(config, joints, command)
        case Retract():
            return plan_retract(config, joints, command)
        case _:
            assert_never(command)
