"""What each command does, and when it is refused. A command is checked whole before anything moves."""

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    ClearFault,
    Command,
    GuardedMove,
    MoveJoints,
    MoveTool,
    Retract,
    SetReference,
    Stop,
    Unstow,
)
from fsw.dictionary.evrs import (
    BranchChosen,
    CommandAccepted,
    CommandCompleted,
    CommandRefused,
    Evr,
    FaultCleared,
    ReferenceSet,
)
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate, set_reference
from fsw.executive.checks import MoveCommand, malformed
from fsw.executive.modes import TRANSITIONS, Event, after
from fsw.kinematics.transforms import Array
from fsw.motion.move import Move, stop
from fsw.motion.paths import Setpoint
from fsw.motion.plan import Plan, Refusal, over_limits, plan_poses, worst_limit
from fsw.motion.plan_line import plan_guarded, plan_retract
from fsw.motion.plan_tool import plan_tool
from fsw.state import State


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What commands act on; each returns it changed."""

    state: State
    usable: bool
    """Whether this cycle's readings are."""
    touching: bool
    """Whether any contact switch is closed."""
    evrs: tuple[Evr, ...] = ()


def handle(config: Config, now: Situation, command: Command) -> Situation:
    """The situation after a command: changed if it was accepted, with a reason if it was refused."""
    match command:
        case SetReference():
            return _set_reference(config, now, command)
        case ClearFault():
            return _clear_fault(config, now, command)
        case Stop():
            return _stop(config, now, command)
        case Unstow() | MoveJoints() | MoveTool() | GuardedMove() | Retract():
            return _begin_move(config, now, command)
        case _:
            assert_never(command)


_EVENT_OF: dict[type, Event] = {
    Unstow: Event.UNSTOW,
    MoveJoints: Event.MOVE_FREE,
    MoveTool: Event.MOVE_FREE,
    GuardedMove: Event.MOVE_GUARDED,
    Retract: Event.MOVE_BACK,
}


def _begin_move(config: Config, now: Situation, command: MoveCommand) -> Situation:
    problem = _not_now(now) or malformed(command)
    if problem is not None:
        return _refused(now, command, problem)
    mode = after(now.state.mode, _EVENT_OF[type(command)])
    if mode is None:
        return _refused(now, command, f"not allowed in mode {now.state.mode.name}")
    touching = now.state.mode is Mode.GUARDED
    if touching and isinstance(command, GuardedMove | Retract) and command.tool is not now.state.tool:
        return _refused(now, command, f"{now.state.tool.name} is the tool that may touch; retract it first")
    plan = _plan(config, now.state.joints, command)
    if isinstance(plan, Refusal):
        return _refused(now, command, plan.reason)
    tool = now.state.tool if isinstance(command, Unstow | MoveJoints) else command.tool
    move = Move(
        command=_name(command),
        end_mode=TRANSITIONS[mode, Event.DONE],
        paths=plan.paths,
        hold=Setpoint(now.state.joints.motor_rad, np.zeros_like(now.state.joints.motor_rad)),
        guarded=tool if isinstance(command, GuardedMove) else None,
    )
    evrs: tuple[Evr, ...] = (CommandAccepted(_name(command)),)
    if plan.branch is not None:
        evrs = (*evrs, BranchChosen(tool, plan.branch))
    state = replace(now.state, mode=mode, tool=tool, move=move, planned_gap_rad=plan.gap_rad)
    return replace(now, state=state, evrs=(*now.evrs, *evrs))


def _not_now(now: Situation) -> str | None:
    """Why no move can begin in this situation."""
    if now.state.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if now.state.move is not None:
        return f"{now.state.move.command} is under way"
    if not now.state.joints.referenced:
        return "the encoders have no reference; set it first"
    return None if now.usable else "a reading is unusable"


def _plan(config: Config, joints: JointEstimate, command: MoveCommand) -> Plan | Refusal:
    match command:
        case Unstow():
            poses = config.params.poses
            return plan_poses(config, joints, [np.array(p) for p in (*poses.unstow_via_rad, poses.ready_rad)])
        case MoveJoints():
            return plan_poses(config, joints, [np.array(command.angle_rad)])
        case MoveTool():
            return plan_tool(config, joints, command)
        case GuardedMove():
            return plan_guarded(config, joints, command)
        case Retract():
            return plan_retract(config, joints, command)
        case _:
            assert_never(command)


def _set_reference(config: Config, now: Situation, command: SetReference) -> Situation:
    problem = _wrong_reference(config, now, command)
    if problem is not None:
        return _refused(now, command, problem)
    joints = set_reference(config, now.state.joints, command)
    evrs = (*now.evrs, ReferenceSet(), CommandCompleted(_name(command)))
    mode = after(now.state.mode, Event.AT_STOW if _at_stow(config, joints.motor_rad) else Event.AWAY)
    mode = now.state.mode if mode is None else mode
    state = replace(now.state, mode=mode, joints=joints, planned_gap_rad=joints.gap_rad)
    return replace(now, state=state, evrs=evrs)


def _wrong_reference(config: Config, now: Situation, command: SetReference) -> str | None:
    told = np.array(command.motor_rad)
    if now.state.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if now.state.move is not None:
        return f"{now.state.move.command} is under way"
    if not now.usable:
        return "a reading is unusable"
    if not np.all(np.isfinite(told)):
        return "a motor angle is not finite"
    if over_limits(config, told) > config.params.motion.reference_margin_rad:
        return worst_limit(config, told)
    if any(side not in (-1, 0, 1) for side in command.gap_side):
        return f"a gap side is not -1, 0 or 1: {command.gap_side}"
    return None


def _clear_fault(config: Config, now: Situation, command: ClearFault) -> Situation:
    mode = after(now.state.mode, _clearing(config, now))
    if mode is None:
        return _refused(now, command, "no fault stands")
    if now.state.move is not None:
        return _refused(now, command, "the arm is still being stopped")
    return replace(
        now,
        state=replace(now.state, mode=mode, fault=None),
        evrs=(*now.evrs, FaultCleared(), CommandCompleted(_name(command))),
    )


def _clearing(config: Config, now: Situation) -> Event:
    """What is cleared depends on where the arm stands: where it may touch, no free move; stowed, only unstow.

    An arm that faulted in a guarded move, in a retraction or on a contact may touch, whatever its switches
    say now.
    """
    fault = now.state.fault
    if now.touching or (fault is not None and fault.may_touch):
        return Event.CLEAR_TOUCHING
    at_stow = now.state.joints.referenced and _at_stow(config, now.state.joints.motor_rad)
    return Event.CLEAR_STOWED if at_stow else Event.CLEAR


def _at_stow(config: Config, motor_rad: Array) -> bool:
    return bool(np.abs(motor_rad - config.params.poses.stowed_rad).max() < config.params.motion.stowed_rad)


def _stop(config: Config, now: Situation, command: Stop) -> Situation:
    evrs = (*now.evrs, CommandCompleted(_name(command)))
    if now.state.move is None or now.state.mode is Mode.FAULTED:
        return replace(now, evrs=evrs)
    still_stowed = now.state.mode is Mode.FREE_SPACE and _at_stow(config, now.state.joints.motor_rad)
    event = Event.STOP_STOWED if still_stowed else Event.STOP
    stopping = stop(config, now.state.move, TRANSITIONS[now.state.mode, event])
    return replace(now, state=replace(now.state, move=stopping), evrs=evrs)


def _refused(now: Situation, command: Command, reason: str) -> Situation:
    return replace(now, evrs=(*now.evrs, CommandRefused(_name(command), reason)))


def _name(command: Command) -> str:
    return type(command).__name__
