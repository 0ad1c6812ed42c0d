"""Planning of single moves: the plan of one command, and a check that all steps of a sequence have one."""

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
    MoveTool,
    PlaceTool,
    Retract,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import AUTO
from fsw.estimate.joints import JointEstimate
from fsw.executive.context import check_arguments
from fsw.executive.expansion import CompoundCommand, expand_command, locate_surface
from fsw.motion.paths import check_paths, check_touch, compute_deflected_frames
from fsw.motion.plan import Compensation, Plan, Refusal, estimate_at, plan_joint, plan_poses
from fsw.motion.plan_tool import find_branches, plan_guarded, plan_retract, plan_tool
from fsw.state import SequenceStep

SingleMoveCommand = Unstow | Stow | MoveJoint | MoveJoints | MoveTool | GuardedMove | Retract

FARTHER_M: Final = (0.0, 0.1, 0.25, 0.4)
"""Distances from the standoff to a way point, or that a tool change retreats beyond it, in order of trial."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSequence:
    """Single commands of a compound command, with the plan of each that moves."""

    commands: tuple[SequenceStep, ...]
    plans: tuple[Plan, ...]
    joints: JointEstimate
    """Estimate of the joints at the end."""
    tool: str
    """Tool of the last tool command."""
    surface: TargetSurface | None
    """Surface of the last target."""

    @property
    def duration_s(self) -> float:
        """Return the duration of all paths, without brakes and settling."""
        return sum(path.duration_s for plan in self.plans for path in plan.paths)


def plan_command(
    config: Config,
    joints: JointEstimate,
    tool: str,
    command: SingleMoveCommand,
    surface: TargetSurface | None,
) -> Plan | Refusal:
    """Plan the move of a command, and check its paths for collisions with rover, ground and surface.

    If the surface, of `locate_surface`, is in the way and a retraction would help, a stow begins with it; the
    refusal of another move names it.
    """
    plan = _plan_checked(config, joints, tool, command, surface)
    if isinstance(plan, Plan) or surface is None or not isinstance(command, Stow | MoveTool):
        return plan
    for back_m in FARTHER_M[1:]:
        back = _plan_checked(config, joints, tool, Retract(tool, back_m), surface)
        if isinstance(back, Refusal):
            break
        onward = _plan_checked(config, estimate_at(joints, back.end), tool, command, surface)
        if isinstance(onward, Plan) and isinstance(command, Stow):
            return replace(onward, paths=back.paths + onward.paths)
        if isinstance(onward, Plan):
            return Refusal(f"{plan.reason}; clear after a retraction of {back_m:g} m")
    return plan


def _plan_checked(
    config: Config,
    joints: JointEstimate,
    tool: str,
    command: SingleMoveCommand,
    surface: TargetSurface | None,
) -> Plan | Refusal:
    """Plan the move of a command as it is, and check its paths."""
    plan = _plan_motion(config, joints, tool, command, surface)
    # the paths of a MoveTool are checked while its branch is chosen
    if isinstance(plan, Refusal) or isinstance(command, MoveTool):
        return plan
    padding_m = config.params.collision.padding_m
    match command:
        case GuardedMove(tool=touching):
            collision = check_paths(config, joints, plan.paths, padding_m, touching)
            if collision is None and surface is not None:
                collision = check_touch(config, joints, plan.paths, touching, surface.normal_R)
        case Stow() if surface is not None:
            # the arm has been in its ready pose since it was unstowed
            ready_rad = np.array(config.params.poses.ready_rad)[:, None]
            ready = compute_deflected_frames(config, joints, ready_rad)
            surface = limit_surface(config.collision_geometry, ready, surface)
            collision = check_paths(config, joints, plan.paths, padding_m, surface=surface)
        case Retract(tool=touching):
            collision = check_paths(config, joints, plan.paths, padding_m, touching, surface)
        case _:
            collision = check_paths(config, joints, plan.paths, padding_m, surface=surface)
    return plan if collision is None else Refusal(collision, is_blocked=True)


def _plan_motion(
    config: Config,
    joints: JointEstimate,
    tool: str,
    command: SingleMoveCommand,
    surface: TargetSurface | None,
) -> Plan | Refusal:
    match command:
        case Unstow():
            poses = config.params.poses
            forth = [np.array(pose) for pose in (*poses.unstow_via_rad, poses.ready_rad)]
            return plan_poses(config, joints, forth, Compensation())
        case Stow():
            poses = config.params.poses
            back = (poses.ready_rad, *reversed(poses.unstow_via_rad), poses.stowed_rad)
            return plan_poses(config, joints, [np.array(pose) for pose in back], Compensation())
        case MoveJoint():
            compensation = Compensation(command.backlash)
            return plan_joint(config, joints, Joint(command.joint), command.angle_rad, compensation)
        case MoveJoints():
            pose = np.array(command.angle_rad) + (joints.output_rad if command.relative else 0.0)
            return plan_poses(config, joints, [pose], Compensation(command.backlash, command.deflection))
        case MoveTool():
            return plan_tool(config, joints, command, tool, surface)
        case GuardedMove():
            return plan_guarded(config, joints, command)
        case Retract():
            return plan_retract(config, joints, command)
        case _:
            assert_never(command)


def plan_sequence(
    config: Config, joints: JointEstimate, tool: str, command: CompoundCommand, surface: TargetSurface | None
) -> PlannedSequence | Refusal:
    """Plan a compound command; each step is planned from the end of the step before it."""
    steps = expand_command(config, joints, tool, command)
    if isinstance(steps, Refusal):
        return steps
    if isinstance(command, PlaceTool | ToolChange):
        standoff = next(step for step in steps if isinstance(step, MoveTool))
        return _plan_fastest(config, joints, tool, command, surface, standoff)
    return plan_steps(config, joints, tool, steps, surface)


def _plan_fastest(
    config: Config,
    joints: JointEstimate,
    tool: str,
    command: PlaceTool | ToolChange,
    surface: TargetSurface | None,
    standoff: MoveTool,
) -> PlannedSequence | Refusal:
    """Plan a placement or tool change on the fastest branch on which every step is clear.

    On each branch, the way leads from as little farther away as is clear.
    """
    branches = find_branches(config, joints, standoff)
    if isinstance(branches, Refusal):
        return branches
    fastest: PlannedSequence | None = None
    refusals = []
    for branch in branches:
        if fastest is not None and fastest.duration_s <= branch.least_s:
            break
        for farther_m in FARTHER_M:
            on_branch = replace(command, branch=branch.name)
            steps = expand_command(config, joints, tool, on_branch, surface, farther_m)
            if isinstance(steps, Refusal):
                return steps
            planned = plan_steps(config, joints, tool, steps, surface)
            if isinstance(planned, PlannedSequence):
                fastest = min(fastest or planned, planned, key=lambda one: one.duration_s)
                break
            refusals.append(planned)
    if fastest is not None:
        return fastest
    if not refusals[0].is_blocked:
        return refusals[0]
    most_m = command.standoff_m + FARTHER_M[-1]
    which = "no" if command.branch == AUTO else f"on branch {command.branch}, no"
    return Refusal(f"{refusals[0].reason}; {which} way from up to {most_m:.2g} m above the surface is clear")


def plan_steps(
    config: Config,
    joints: JointEstimate,
    tool: str,
    steps: tuple[SequenceStep, ...],
    surface: TargetSurface | None,
) -> PlannedSequence | Refusal:
    """Plan each step from the end of the step before it, or return the reason that one is refused."""
    plans = []
    for step in steps:
        if not isinstance(step, SingleMoveCommand):
            continue
        problem = check_arguments(config.params, step)
        if problem is not None:
            return Refusal(problem)
        surface = locate_surface(config, joints, tool, step, surface)
        # a search for a retraction at each move of a placement would take long
        plan_step = plan_command if isinstance(step, Stow) else _plan_checked
        plan = plan_step(config, joints, tool, step, surface)
        if isinstance(plan, Refusal):
            return plan
        plans.append(plan)
        joints = estimate_at(joints, plan.end)
        tool = step.tool if isinstance(step, MoveTool | GuardedMove | Retract) else tool
    return PlannedSequence(steps, tuple(plans), joints, tool, surface)
