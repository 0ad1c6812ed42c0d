"""What each command does, and when it is refused. A command is checked whole before anything moves."""

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
    Dock,
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Preload,
    Process,
    Retract,
    SetParam,
    SetTilt,
    Stop,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.evrs import (
    BranchChosen,
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    CommandRefused,
    Evr,
    FaultCleared,
)
from fsw.dictionary.joints import Joint
from fsw.dictionary.modes import Mode
from fsw.estimate.reference import forgotten
from fsw.executive.checks import malformed
from fsw.executive.hardstop_pose import unsafe, unsafe_for_all
from fsw.executive.modes import TRANSITIONS, Event, after
from fsw.executive.planning import PlannedMove, plan_for
from fsw.executive.sequence import calibrate_all
from fsw.executive.stopping import at_stow, stop_event
from fsw.motion import seek
from fsw.motion.move import Move, stop
from fsw.motion.paths import Setpoint
from fsw.motion.plan import Refusal
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
        case CalibrateAll():
            return _calibrate_all(config, now, command)
        case Calibrate():
            return _calibrate(config, now, command)
        case ClearFault():
            return _clear_fault(config, now, command)
        case Stop():
            return _stop(config, now, command)
        case Stow() | PlaceTool() | Preload() | ToolChange() | MoveTeachPoint() | Dock() | Process():
            return _refused(now, command, "not there yet")
        case SetTilt() | SetParam():
            return _refused(now, command, "not there yet")
        case Unstow() | MoveJoint() | MoveJoints() | MoveTool() | GuardedMove() | Retract():
            return _begin_move(config, now, command)
        case _:
            assert_never(command)


_EVENT_OF: dict[type, Event] = {
    Unstow: Event.UNSTOW,
    MoveJoint: Event.MOVE_FREE,
    MoveJoints: Event.MOVE_FREE,
    MoveTool: Event.MOVE_FREE,
    GuardedMove: Event.MOVE_GUARDED,
    Retract: Event.MOVE_BACK,
}


def proceed(config: Config, now: Situation) -> Situation:
    """The situation after the next command of a sequence, if its last one is done."""
    sequence = now.state.sequence
    if sequence is None or now.state.move is not None:
        return now
    if now.state.mode is Mode.FAULTED:
        return _sequence_over(now, CommandAborted(sequence.command))
    if not sequence.rest:
        return _sequence_over(now, CommandCompleted(sequence.command))
    rest = replace(sequence, rest=sequence.rest[1:])
    begun = handle(config, replace(now, state=replace(now.state, sequence=None)), sequence.rest[0])
    if begun.state.move is None:
        return _sequence_over(begun, CommandAborted(sequence.command))
    return replace(begun, state=replace(begun.state, sequence=rest))


def _sequence_over(now: Situation, evr: Evr) -> Situation:
    return replace(now, state=replace(now.state, sequence=None), evrs=(*now.evrs, evr))


def _calibrate_all(config: Config, now: Situation, command: CalibrateAll) -> Situation:
    problem = _not_now(now) or _not_free(now) or unsafe_for_all(config, now.state.joints)
    if problem is not None:
        return _refused(now, command, problem)
    accepted = (*now.evrs, CommandAccepted(_name(command)))
    return replace(
        now, state=replace(now.state, sequence=calibrate_all(config.params, command.anew)), evrs=accepted
    )


def _calibrate(config: Config, now: Situation, command: Calibrate) -> Situation:
    problem = _not_now(now) or malformed(command) or _not_free(now)
    problem = problem or unsafe(config, now.state.joints, command.joint)
    if problem is not None:
        return _refused(now, command, problem)
    joints, mode = now.state.joints, TRANSITIONS[now.state.mode, Event.MOVE_FREE]
    move = _at_rest(config, now, command, TRANSITIONS[mode, Event.DONE])
    move = replace(
        move,
        active=np.arange(joints.motor_rad.size) == command.joint,
        seek=seek.begin(Joint(command.joint), joints, command.anew),
    )
    joints = replace(joints, reference=forgotten(joints.reference, command.joint))
    state = replace(now.state, mode=mode, move=move, joints=joints)
    return replace(now, state=state, evrs=(*now.evrs, CommandAccepted(_name(command))))


def _begin_move(config: Config, now: Situation, command: PlannedMove) -> Situation:
    problem = _not_now(now) or _not_calibrated(now, command) or malformed(command)
    if problem is not None:
        return _refused(now, command, problem)
    mode = after(now.state.mode, _EVENT_OF[type(command)])
    if mode is None:
        return _refused(now, command, f"not allowed in mode {now.state.mode.name}")
    touching = now.state.mode is Mode.GUARDED
    if touching and isinstance(command, GuardedMove | Retract) and command.tool is not now.state.tool:
        return _refused(now, command, f"{now.state.tool.name} is the tool that may touch; retract it first")
    plan = plan_for(config, now.state.joints, now.state.tool, command)
    if isinstance(plan, Refusal):
        return _refused(now, command, plan.reason)
    tool = command.tool if isinstance(command, MoveTool | GuardedMove | Retract) else now.state.tool
    move = replace(
        _at_rest(config, now, command, TRANSITIONS[mode, Event.DONE]),
        paths=plan.paths,
        guarded=tool if isinstance(command, GuardedMove) else None,
    )
    if isinstance(command, MoveJoint):
        move = replace(move, active=np.arange(move.active.size) == command.joint)
    evrs: tuple[Evr, ...] = (CommandAccepted(_name(command)),)
    if plan.branch is not None:
        evrs = (*evrs, BranchChosen(tool, plan.branch))
    state = replace(now.state, mode=mode, tool=tool, move=move, planned_gap_rad=plan.gap_rad)
    return replace(now, state=state, evrs=(*now.evrs, *evrs))


def _at_rest(config: Config, now: Situation, command: Command, end_mode: Mode) -> Move:
    """A move of all joints that has yet to go anywhere."""
    motor = now.state.joints.motor_rad
    return Move(
        command=_name(command),
        end_mode=end_mode,
        active=np.ones(motor.size, bool),
        limit_A=config.current_limit_A,
        paths=(),
        hold=Setpoint(motor, np.zeros_like(motor)),
    )


def _not_now(now: Situation) -> str | None:
    """Why no move can begin in this situation."""
    if now.state.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if now.state.move is not None:
        return f"{now.state.move.command} is under way"
    if now.state.sequence is not None:
        return f"{now.state.sequence.command} is under way"
    return None if now.usable else "a reading is unusable"


def _not_free(now: Situation) -> str | None:
    """Why no free motion can begin in this mode."""
    free = after(now.state.mode, Event.MOVE_FREE) is not None
    return None if free else f"not allowed in mode {now.state.mode.name}"


def _not_calibrated(now: Situation, command: PlannedMove) -> str | None:
    """Why this command must wait until joints are calibrated."""
    known = now.state.joints.reference.calibrated
    needed = (command.joint,) if isinstance(command, MoveJoint) else tuple(Joint)
    missing = [Joint(joint).name.lower() for joint in needed if joint in tuple(Joint) and not known[joint]]
    if not missing:
        return None
    return f"not calibrated: {', '.join(missing)}; until it is, a joint may only look for its hardstop"


def _clear_fault(config: Config, now: Situation, command: ClearFault) -> Situation:
    mode = after(now.state.mode, _clearing(config, now))
    if mode is None:
        return _refused(now, command, "no fault stands")
    if now.state.move is not None:
        return _refused(now, command, "the arm is still being stopped")
    if now.state.sequence is not None:
        now = _sequence_over(now, CommandAborted(now.state.sequence.command))
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
    return Event.CLEAR_STOWED if at_stow(config, now.state.joints) else Event.CLEAR


def _stop(config: Config, now: Situation, command: Stop) -> Situation:
    if now.state.sequence is not None:
        now = _sequence_over(now, CommandAborted(now.state.sequence.command))
    evrs = (*now.evrs, CommandCompleted(_name(command)))
    if now.state.move is None or now.state.mode is Mode.FAULTED:
        return replace(now, evrs=evrs)
    event = stop_event(config, now.state.mode, now.state.joints)
    stopping = stop(config, now.state.move, TRANSITIONS[now.state.mode, event])
    return replace(now, state=replace(now.state, move=stopping), evrs=evrs)


def _refused(now: Situation, command: Command, reason: str) -> Situation:
    return replace(now, evrs=(*now.evrs, CommandRefused(_name(command), reason)))


def _name(command: Command) -> str:
    return type(command).__name__
