"""What each command does, and when it is refused. A command is checked whole before anything moves."""

from dataclasses import replace
from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
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
from fsw.dictionary.enums import Joint, Mode, Tool
from fsw.dictionary.evrs import (
    BranchChosen,
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    Evr,
    Preloaded,
    SpotTaken,
)
from fsw.dictionary.types import vector3
from fsw.estimate.reference import forget_joint
from fsw.executive.checks import beyond, malformed
from fsw.executive.hardstop_pose import unsafe, unsafe_for_all
from fsw.executive.modes import EVENT_OF, TRANSITIONS, Event
from fsw.executive.planning import PlannedMove, ahead, plan_for
from fsw.executive.sequence import calibrate_all
from fsw.executive.settings import set_param, set_tilt
from fsw.executive.situation import (
    Situation,
    name_of,
    not_calibrated,
    not_in_mode,
    not_now,
    pressing_of,
    refused,
    told,
    touches,
)
from fsw.executive.steps import Stepped, spot, steps_of
from fsw.executive.stopping import clear_fault, sequence_over, stop_move
from fsw.motion import seek
from fsw.motion.move import Move
from fsw.motion.paths import Setpoint, StillPath
from fsw.motion.plan import Refusal
from fsw.motion.plan_press import Pressing, plan_press, press_limit_A, touched
from fsw.motion.trim import PressFit
from fsw.state import Hold, Sequence, Step


def handle(config: Config, now: Situation, command: Step) -> Situation:
    """The situation after a command: changed if it was accepted, with a reason if it was refused."""
    match command:
        case CalibrateAll():
            return _calibrate_all(config, now, command)
        case Calibrate():
            return _calibrate(config, now, command)
        case ClearFault():
            return clear_fault(config, now, command)
        case Stop():
            return stop_move(config, now, command)
        case SetTilt():
            return set_tilt(config, now, command)
        case SetParam():
            return set_param(config, now, command)
        case Preload():
            return _press(config, now, command)
        case Hold():
            return _hold(config, now, command)
        case PlaceTool() | ToolChange() | MoveTeachPoint() | Dock() | Process():
            return _begin_steps(config, now, command)
        case Unstow() | Stow() | MoveJoint() | MoveJoints() | MoveTool() | GuardedMove() | Retract():
            return _begin_move(config, now, command)
        case _:
            assert_never(command)


def proceed(config: Config, now: Situation) -> Situation:
    """The situation after the next step of a sequence, if its last one is done."""
    sequence = now.state.sequence
    if sequence is None or now.state.move is not None:
        return now
    if now.state.mode is Mode.FAULTED:
        return sequence_over(now, CommandAborted(sequence.command))
    if not sequence.rest:
        return sequence_over(now, CommandCompleted(sequence.command))
    rest = replace(sequence, rest=sequence.rest[1:])
    begun = handle(config, replace(now, state=replace(now.state, sequence=None)), sequence.rest[0])
    if begun.state.move is None:
        return sequence_over(begun, CommandAborted(sequence.command))
    return replace(begun, state=replace(begun.state, sequence=rest))


def _begin_steps(config: Config, now: Situation, command: Stepped) -> Situation:
    """Every step is planned from the end of the one before it, and only then does the first begin."""
    state = now.state
    problem = not_now(now) or not_calibrated(now, command) or malformed(command)
    problem = problem or not_in_mode(now, EVENT_OF[type(command)])
    if isinstance(command, ToolChange):
        problem = problem or _no_tool_change(now, command)
    if isinstance(command, Dock):
        problem = problem or _other_tool_touches(now, None)
    if problem is not None:
        return refused(now, command, problem)
    steps = steps_of(config, state.joints, state.tool, command)
    if isinstance(steps, Refusal):
        return refused(now, command, steps.reason)
    problem = ahead(config, state, steps)
    if problem is not None:
        return refused(now, command, problem)
    evrs: tuple[Evr, ...] = (CommandAccepted(name_of(command)),)
    if isinstance(command, ToolChange):
        evrs = (*evrs, SpotTaken(state.tool, *vector3(spot(config, state.joints, state.tool, command).p_m)))
    sequence = Sequence(name_of(command), steps)
    return told(replace(now, state=replace(state, sequence=sequence)), *evrs)


def _no_tool_change(now: Situation, command: ToolChange) -> str | None:
    if command.tool is now.state.tool:
        return f"{command.tool.name} is the tool that touches"
    if touches(now, now.state.tool):
        return None
    return f"{now.state.tool.name} touches nothing: there is no spot to go back to"


def _other_tool_touches(now: Situation, tool: Tool | None) -> str | None:
    """Where one tool may touch, no other is moved onto or off anything."""
    if now.state.mode in (Mode.GUARDED, Mode.PRELOAD) and tool is not now.state.tool:
        return f"{now.state.tool.name} is the tool that may touch; retract it first"
    return None


def _calibrate_all(config: Config, now: Situation, command: CalibrateAll) -> Situation:
    problem = not_now(now) or not_in_mode(now, Event.MOVE_FREE) or unsafe_for_all(config, now.state.joints)
    if problem is not None:
        return refused(now, command, problem)
    begun = replace(now, state=replace(now.state, sequence=calibrate_all(config.params, command.anew)))
    return told(begun, CommandAccepted(name_of(command)))


def _calibrate(config: Config, now: Situation, command: Calibrate) -> Situation:
    problem = not_now(now) or malformed(command) or not_in_mode(now, Event.MOVE_FREE)
    problem = problem or unsafe(config, now.state.joints, Joint(command.joint))
    if problem is not None:
        return refused(now, command, problem)
    joints, mode = now.state.joints, TRANSITIONS[now.state.mode, Event.MOVE_FREE]
    move = _at_rest(config, now, command, TRANSITIONS[mode, Event.DONE])
    move = replace(
        move,
        active=np.arange(joints.motor_rad.size) == command.joint,
        seek=seek.begin(Joint(command.joint), joints, command.anew),
    )
    joints = replace(joints, reference=forget_joint(joints.reference, command.joint))
    state = replace(now.state, mode=mode, move=move, joints=joints)
    return told(replace(now, state=state), CommandAccepted(name_of(command)))


def _begin_move(config: Config, now: Situation, command: PlannedMove) -> Situation:
    problem = not_now(now) or malformed(command) or not_calibrated(now, command)
    problem = problem or not_in_mode(now, EVENT_OF[type(command)])
    if isinstance(command, GuardedMove | Retract):
        problem = problem or _other_tool_touches(now, command.tool)
    if problem is not None:
        return refused(now, command, problem)
    plan = plan_for(config, now.state.joints, now.state.tool, command)
    if isinstance(plan, Refusal):
        return refused(now, command, plan.reason)
    mode = TRANSITIONS[now.state.mode, EVENT_OF[type(command)]]
    done = Event.DONE_STOWED if isinstance(command, Stow) else Event.DONE
    tool = command.tool if isinstance(command, MoveTool | GuardedMove | Retract) else now.state.tool
    move = replace(
        _at_rest(config, now, command, TRANSITIONS[mode, done]),
        paths=plan.paths,
        guarded=tool if isinstance(command, GuardedMove) else None,
    )
    if isinstance(command, MoveJoint):
        move = replace(move, active=np.arange(move.active.size) == command.joint)
    evrs: tuple[Evr, ...] = (CommandAccepted(name_of(command)),)
    if plan.branch is not None:
        evrs = (*evrs, BranchChosen(tool, plan.branch))
    # a guarded move of a tool that touches already does not press it on
    stays = isinstance(command, GuardedMove) and touches(now, tool)
    pressing = pressing_of(now, tool) if stays else None
    state = replace(
        now.state, mode=mode, tool=tool, move=move, pressing=pressing, planned_gap_rad=plan.gap_rad
    )
    return told(replace(now, state=state), *evrs)


def _press(config: Config, now: Situation, command: Preload) -> Situation:
    state = now.state
    problem = not_now(now) or not_calibrated(now, command) or malformed(command)
    problem = problem or not_in_mode(now, Event.PRESS) or _other_tool_touches(now, command.tool)
    problem = problem or beyond(config.params, command)
    if problem is None and command.force_N > 0 and not touches(now, command.tool):
        problem = f"{command.tool.name} touches nothing: there is nothing to press on"
    if problem is not None:
        return refused(now, command, problem)
    pressing = state.pressing or touched(config, state.joints, command.tool)
    if (
        state.mode is Mode.PRELOAD
        and command.force_N == 0
        and pressing.force_N < config.params.preload.step_N
    ):
        return _let_go(now, command, pressing)
    if abs(command.force_N - pressing.force_N) < config.params.preload.step_N:
        return refused(now, command, f"{command.tool.name} is pressed with {pressing.force_N:.1f} N as it is")
    planned = plan_press(config, state.joints, pressing, command.force_N)
    if isinstance(planned, Refusal):
        return refused(now, command, planned.reason)
    plan, press = planned
    done = Event.DONE_RELEASED if command.force_N == 0 else Event.DONE
    move = replace(
        _at_rest(config, now, command, TRANSITIONS[Mode.PRELOAD, done]),
        paths=plan.paths,
        press=press,
        fit=PressFit() if press.change_N > 0 else None,
        limit_A=press_limit_A(config, state.joints, press),
    )
    state = replace(state, mode=Mode.PRELOAD, move=move, pressing=pressing, planned_gap_rad=plan.gap_rad)
    return told(replace(now, state=state), CommandAccepted(name_of(command)))


def _let_go(now: Situation, command: Preload, pressing: Pressing) -> Situation:
    """A release that was stopped near its end: what is left of the force is no more than that of a touch."""
    name, mode = name_of(command), TRANSITIONS[Mode.PRELOAD, Event.DONE_RELEASED]
    pressed = Preloaded(pressing.tool, pressing.force_N)
    now = replace(now, state=replace(now.state, mode=mode))
    return told(now, CommandAccepted(name), pressed, CommandCompleted(name))


def _hold(config: Config, now: Situation, command: Hold) -> Situation:
    problem = not_now(now) or not_in_mode(now, Event.MOVE_FREE)
    if problem is not None:
        return refused(now, command, problem)
    mode = TRANSITIONS[now.state.mode, Event.MOVE_FREE]
    still = _at_rest(config, now, command, TRANSITIONS[mode, Event.DONE])
    move = replace(
        still,
        active=np.zeros_like(still.active),
        paths=(StillPath(command.duration_s, still.hold.motor_rad),),
        vibrate=command.vibrate,
    )
    return told(
        replace(now, state=replace(now.state, mode=mode, move=move)), CommandAccepted(name_of(command))
    )


def _at_rest(config: Config, now: Situation, command: Step, end_mode: Mode) -> Move:
    """A move of all joints that has yet to go anywhere."""
    motor = now.state.joints.motor_rad
    return Move(
        command=name_of(command),
        end_mode=end_mode,
        active=np.ones(motor.size, bool),
        limit_A=config.current_limit_A,
        paths=(),
        hold=Setpoint(motor, np.zeros_like(motor)),
    )
