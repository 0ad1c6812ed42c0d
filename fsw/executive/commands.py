"""Command handling: each command is planned, begins a move, changes a setting, or is refused.

A command is checked completely before anything moves.
"""

from dataclasses import replace
from typing import Any, assert_never

import numpy as np

from fsw.collision.geometry import TargetSurface
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
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import (
    BranchChosen,
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    Evr,
    FaultCleared,
    Preloaded,
    SpotSet,
)
from fsw.dictionary.faults import ContactInFreeSpace
from fsw.dictionary.types import vector3
from fsw.estimate.joints import JointEstimate
from fsw.estimate.reference import forget_joint, recount_joint
from fsw.executive.backlash import assess_backlash
from fsw.executive.context import (
    EVENT_OF,
    TRANSITIONS,
    CommandContext,
    ModeEvent,
    check_arguments,
    check_calibrated,
    check_force,
    check_mode,
    check_ready,
    command_name,
    in_contact,
    is_stowed,
    next_mode,
    refuse,
    set_param,
    set_tilt,
    stop_event,
    tool_preload,
    with_events,
)
from fsw.executive.expansion import (
    CompoundCommand,
    expand_calibrate_all,
    locate_spot,
    locate_surface,
    locate_touched_surface,
)
from fsw.executive.planning import MotionCommand, PlannedSequence, SingleMoveCommand, Start, plan_command
from fsw.executive.poses import check_homing, check_homing_all
from fsw.messages import Flags
from fsw.motion import homing
from fsw.motion.force_fit import ForceFit
from fsw.motion.move import ALL_JOINTS, NO_JOINTS, Move, MovePlan, stop_early
from fsw.motion.paths import HoldPath, Setpoint
from fsw.motion.plan import Plan, Refusal
from fsw.motion.preload import (
    PressPlan,
    anchor_contact,
    locate_by_resolvers,
    model_contact,
    plan_preload,
    preload_limit_A,
)
from fsw.motion.work import Work
from fsw.protect.readings import ReadingState, accept_present
from fsw.state import Hold, Planning, Sequence, SequenceStep


def handle(config: Config, context: CommandContext, command: SequenceStep) -> CommandContext:
    """Handle a command whose arguments have their types and limits, or a step of a sequence.

    The context has what the command changed, or the event that gives the reason for a refusal.
    """
    match command:
        case CalibrateAll():
            return _begin_calibrate_all(config, context, command)
        case Calibrate():
            return _begin_calibrate(config, context, command)
        case ClearFault():
            return clear_fault(config, context, command)
        case Stop():
            return stop_move(config, context, command)
        case SetTilt():
            return set_tilt(config, context, command)
        case SetParam():
            return set_param(config, context, command)
        case Preload():
            return _plan_press(config, context, command)
        case Hold():
            return _begin_hold(config, context, command)
        case PlaceTool() | ToolChange() | MoveTeachPoint() | Dock() | Process():
            return _plan_motion(config, context, command)
        case Unstow() | Stow() | MoveJoint() | MoveJoints() | MoveTool() | GuardedMove() | Retract():
            return _plan_motion(config, context, command)
        case _:
            assert_never(command)


def continue_planning(config: Config, context: CommandContext) -> CommandContext:
    """Do the next piece of planning; with a plan the command begins, with a refusal it ends.

    A plan from first readings that the next ones contradict is given up.
    """
    planning = context.state.planning
    if planning is None:
        return context
    if context.state.mode is Mode.FAULTED or context.state.readings.begins:
        return end_planning(context)
    result = planning.work.advance(config)
    if isinstance(result, Work):
        return replace(context, state=replace(context.state, planning=replace(planning, work=result)))
    state = replace(context.state, mode=planning.rest_mode, planning=None)
    context = replace(context, state=state)
    if not isinstance(result, Refusal):
        result = _refuse_moved(config, context, planning) or result
    if isinstance(result, Refusal):
        context = refuse(context, planning.command, result.reason)
        if state.sequence is None:
            return context
        return end_sequence(context, CommandAborted(state.sequence.command))
    if isinstance(result, PressPlan):
        return _begin_press(config, context, planning.command, result)
    if isinstance(planning.command, CompoundCommand):
        return _begin_sequence(config, context, planning, result)
    assert isinstance(planning.command, SingleMoveCommand)  # no other command is planned
    return _begin_move(config, context, planning.command, result.plans, planning.surface)


def _refuse_moved(config: Config, context: CommandContext, planning: Planning) -> Refusal | None:
    """Refuse a plan whose start the motors have left, although their brakes were on."""
    moved_rad = np.abs(context.state.joints.motor_rad - planning.start_rad)
    if moved_rad.max() <= config.params.motion.settle_error_rad:
        return None
    joint = Joint(int(moved_rad.argmax()))
    return Refusal(
        f"{joint.name.lower()} has moved by {moved_rad[joint]:.6f} rad while the command was planned; "
        "send it again"
    )


def end_planning(context: CommandContext) -> CommandContext:
    """Give up the command that is being planned, and report it unless it is a step of a sequence."""
    state = context.state
    if state.planning is None:
        return context
    mode = state.mode if state.mode is Mode.FAULTED else state.planning.rest_mode
    ended = replace(context, state=replace(state, mode=mode, planning=None))
    if state.sequence is not None:
        return ended
    return with_events(ended, CommandAborted(command_name(state.planning.command)))


def continue_sequence(config: Config, context: CommandContext) -> CommandContext:
    """Begin the next step of the sequence if none is under way; abort it if a step is refused."""
    state, sequence = context.state, context.state.sequence
    if sequence is None or state.move is not None or state.planning is not None:
        return context
    if state.mode is Mode.FAULTED:
        return end_sequence(context, CommandAborted(sequence.command))
    if not sequence.remaining:
        return end_sequence(context, CommandCompleted(sequence.command))
    remaining = replace(sequence, remaining=sequence.remaining[1:])
    begun = handle(config, replace(context, state=replace(state, sequence=None)), sequence.remaining[0])
    if begun.state.move is None and begun.state.planning is None:
        return end_sequence(begun, CommandAborted(sequence.command))
    return replace(begun, state=replace(begun.state, sequence=remaining))


def clear_fault(config: Config, context: CommandContext, command: ClearFault) -> CommandContext:
    """Clear the fault, so that commands are accepted again."""
    mode = next_mode(context.state.mode, _clear_event(config, context))
    if mode is None:
        return refuse(context, command, "no fault stands")
    if context.state.move is not None:
        return refuse(context, command, "the arm is still being stopped")
    accepted = accept_present(config.readings, context.state.readings)
    if isinstance(accepted, str):
        return refuse(context, command, accepted)
    context = end_planning(context)
    if context.state.sequence is not None:
        context = end_sequence(context, CommandAborted(context.state.sequence.command))
    context = _use_present(config, context, *accepted)
    tool = _touching_tool(config, context) if mode is Mode.GUARDED else context.state.tool
    state = replace(context.state, mode=mode, tool=tool, preload=tool_preload(context, tool), fault=None)
    context = replace(context, state=state)
    return with_events(context, FaultCleared(), CommandCompleted(command_name(command)))


def _use_present(
    config: Config, context: CommandContext, readings: ReadingState, jumps: tuple[tuple[Joint, int], ...]
) -> CommandContext:
    """Use readings that stayed at a new value; a motor whose counter jumped is where it was."""
    joints = context.state.joints
    for joint, count in jumps:
        shift_rad = -count * float(config.rad_per_count[joint])
        joints = replace(joints, reference=recount_joint(joints.reference, joint, shift_rad))
    return replace(context, state=replace(context.state, readings=readings, joints=joints))


def stop_move(config: Config, context: CommandContext, command: Stop) -> CommandContext:
    """Abort the sequence, and stop the move or the planning under way."""
    context = end_planning(context)
    if context.state.sequence is not None:
        context = end_sequence(context, CommandAborted(context.state.sequence.command))
    context = with_events(context, CommandCompleted(command_name(command)))
    if context.state.move is None or context.state.mode is Mode.FAULTED:
        return context
    stopping = stop_early(
        config,
        context.state.move,
        TRANSITIONS[context.state.mode, stop_event(config, context.state.mode, context.state.joints)],
    )
    return replace(context, state=replace(context.state, move=stopping))


def end_sequence(context: CommandContext, evr: Evr) -> CommandContext:
    """Remove the sequence from the context, and report an event."""
    return with_events(replace(context, state=replace(context.state, sequence=None)), evr)


def _touching_tool(config: Config, context: CommandContext) -> str:
    """Find the tool of a switch that is closed or was reported by the fault; else the last commanded tool."""
    switches = [k for k, is_closed in enumerate(context.closed) if is_closed]
    if context.state.fault is not None:
        reported = [about for event, about in context.state.fault.reported if event is ContactInFreeSpace]
        switches += [k for k, name in enumerate(config.protection.switch_names) if name in reported]
    return next((config.params.switches[k].tool for k in switches), context.state.tool)


def _clear_event(config: Config, context: CommandContext) -> ModeEvent:
    """Choose the event of a cleared fault, which decides the moves that are allowed next.

    After a fault in a guarded move, in a retraction or in contact, the arm may touch, even with all switches
    open: no free move is allowed. A tool that pressed may still press. A stowed arm may only unstow.
    """
    fault, preload = context.state.fault, context.state.preload
    if preload is not None and preload.force_N > config.params.holding_force_N[preload.tool]:
        return ModeEvent.CLEAR_PRESSED
    if context.closed.any() or (fault is not None and fault.may_touch):
        return ModeEvent.CLEAR_TOUCHING
    return ModeEvent.CLEAR_STOWED if is_stowed(config, context.state.joints) else ModeEvent.CLEAR


def _plan_motion(config: Config, context: CommandContext, command: MotionCommand) -> CommandContext:
    """Begin the planning of a command that moves the arm, after the checks that need no plan."""
    state = context.state
    problem = (
        check_ready(context) or check_arguments(config.params, command) or check_calibrated(context, command)
    )
    problem = problem or check_mode(context, EVENT_OF[type(command)])
    events: tuple[Evr, ...] = ()
    match command:
        case GuardedMove() | Retract():
            problem = problem or _check_other_tool(context, command.tool)
        case ToolChange():
            problem = problem or _check_tool_change(config, context, command)
            if problem is None:
                undecided = assess_backlash(config, state.joints, state.tool)
                problem = undecided.refusal(config.params.motion.spot_error_m)
                spot = locate_spot(config, state.joints, state.tool, command)
                events = (SpotSet(state.tool, *vector3(spot.p_m)), *undecided.events)
        case Dock():
            problem = problem or _check_other_tool(context, None)
        case _:
            pass
    if problem is not None:
        return refuse(context, command, problem)
    surface = locate_surface(config, state.joints, state.tool, command, known_surface(config, context))
    work = plan_command(Start(state.joints, state.tool, surface), command)
    return _plan(context, command, work, surface, *events)


def _plan(
    context: CommandContext,
    command: SequenceStep,
    work: Work[Any],
    surface: TargetSurface | None,
    *events: Evr,
) -> CommandContext:
    """Begin the planning of a command, which the arm awaits on its brakes."""
    state = context.state
    planning = Planning(command, state.mode, surface, events, state.joints.motor_rad, work)
    mode = TRANSITIONS[state.mode, ModeEvent.PLAN]
    return replace(context, state=replace(state, mode=mode, planning=planning))


def _begin_sequence(
    config: Config, context: CommandContext, planning: Planning, planned: PlannedSequence
) -> CommandContext:
    """Begin a compound command with its first step; the others are planned again when they begin."""
    first, *others = planned.commands
    assert isinstance(first, SingleMoveCommand)  # every expansion begins with a move
    context = _accept(context, planning.command, *planning.events)
    begun = _begin_move(config, context, first, planned.plans[:1], planning.surface)
    sequence = Sequence(command_name(planning.command), tuple(others))
    return replace(begun, state=replace(begun.state, sequence=sequence))


def known_surface(config: Config, context: CommandContext) -> TargetSurface | None:
    """Return the surface of the last target; through the tip of the tool if that touches now."""
    state = context.state
    if not in_contact(config, context, state.tool):
        return state.surface
    return locate_touched_surface(config, state.joints, state.tool, state.surface)


def _check_tool_change(config: Config, context: CommandContext, command: ToolChange) -> str | None:
    """Check that the present tool is in contact and the other tool is a different one."""
    if command.tool == context.state.tool:
        return f"{command.tool} is the tool that touches"
    if in_contact(config, context, context.state.tool):
        return None
    return f"{context.state.tool} touches nothing: there is no spot to go back to"


def _check_other_tool(context: CommandContext, tool: str | None) -> str | None:
    """Check that no tool but this one may be in contact."""
    if context.state.mode in (Mode.GUARDED, Mode.PRELOAD) and tool != context.state.tool:
        return f"{context.state.tool} is the tool that may touch; retract it first"
    return None


def _begin_calibrate_all(config: Config, context: CommandContext, command: CalibrateAll) -> CommandContext:
    problem = (
        check_ready(context)
        or check_mode(context, ModeEvent.MOVE_FREE)
        or check_homing_all(config, context.state.joints)
    )
    if problem is not None:
        return refuse(context, command, problem)
    return _accept(context, command, sequence=expand_calibrate_all(config.params, command.accept_moved))


def _begin_calibrate(config: Config, context: CommandContext, command: Calibrate) -> CommandContext:
    problem = (
        check_ready(context)
        or check_arguments(config.params, command)
        or check_mode(context, ModeEvent.MOVE_FREE)
    )
    problem = problem or check_homing(config, context.state.joints, Joint(command.joint))
    if problem is not None:
        return refuse(context, command, problem)
    joint, joints = Joint(command.joint), context.state.joints
    mode = TRANSITIONS[context.state.mode, ModeEvent.MOVE_FREE]
    plan = MovePlan(command_name(command), TRANSITIONS[mode, ModeEvent.DONE], _only(joint))
    move = replace(
        _new_move(config, joints, plan), homing=homing.begin_homing(joint, joints, command.accept_moved)
    )
    joints = replace(joints, reference=forget_joint(joints.reference, joint))
    return _accept(context, command, mode=mode, move=move, joints=joints)


def _begin_move(
    config: Config,
    context: CommandContext,
    command: SingleMoveCommand,
    plans: tuple[Plan, ...],
    surface: TargetSurface | None,
) -> CommandContext:
    """Begin the move of a single command, along these plans."""
    joints = context.state.joints
    mode = TRANSITIONS[context.state.mode, EVENT_OF[type(command)]]
    done = ModeEvent.DONE_STOWED if isinstance(command, Stow) else ModeEvent.DONE
    tool = command.tool if isinstance(command, MoveTool | GuardedMove | Retract) else context.state.tool
    last = plans[-1]
    move = MovePlan(
        command_name(command),
        TRANSITIONS[mode, done],
        _only(command.joint) if isinstance(command, MoveJoint) else ALL_JOINTS,
        tuple(path for plan in plans for path in plan.paths),
        guarded_tool=tool if isinstance(command, GuardedMove) else None,
    )
    # a guarded move of a tool already in contact ends at once: the preload stays as it is
    is_kept = isinstance(command, GuardedMove) and in_contact(config, context, tool)
    return _accept(
        context,
        command,
        *(() if last.branch is None else (BranchChosen(tool, last.branch),)),
        mode=mode,
        tool=tool,
        move=_new_move(config, joints, move),
        preload=tool_preload(context, tool) if is_kept else None,
        planned_backlash_rad=last.backlash_rad,
        surface=surface,
    )


def _plan_press(config: Config, context: CommandContext, command: Preload) -> CommandContext:
    """Begin the planning of a press, after the checks that need no plan."""
    state = context.state
    problem = (
        check_ready(context) or check_calibrated(context, command) or check_arguments(config.params, command)
    )
    problem = problem or check_mode(context, ModeEvent.PRESS) or _check_other_tool(context, command.tool)
    problem = problem or check_force(config.params, command)
    if problem is None and command.force_N > 0 and not in_contact(config, context, command.tool):
        problem = f"{command.tool} touches nothing: there is nothing to press on"
    if problem is not None:
        return refuse(context, command, problem)
    preload = state.preload or model_contact(config, state.joints, command.tool)
    if state.mode is Mode.PRELOAD and command.force_N == 0 and preload.force_N < config.params.preload.step_N:
        # the release was stopped near its end: the remaining force is that of a touch at most
        evrs = Preloaded(preload.tool, preload.force_N), CommandCompleted(command_name(command))
        return _accept(context, command, *evrs, mode=TRANSITIONS[Mode.PRELOAD, ModeEvent.DONE_RELEASED])
    if abs(command.force_N - preload.force_N) < config.params.preload.step_N:
        return refuse(context, command, f"{command.tool} is pressed with {preload.force_N:.1f} N as it is")
    located = locate_by_resolvers(state.joints, preload)
    if state.mode is Mode.GUARDED:
        preload = anchor_contact(config, located, preload)
    work = plan_preload(config, located, preload, command.force_N)
    return _plan(context, command, work, state.surface)


def _begin_press(
    config: Config, context: CommandContext, command: SequenceStep, planned: PressPlan
) -> CommandContext:
    """Begin a press."""
    state, change = context.state, planned.change
    done = ModeEvent.DONE_RELEASED if change.target_N == 0 else ModeEvent.DONE
    end_mode = TRANSITIONS[Mode.PRELOAD, done]
    press = MovePlan(command_name(command), end_mode, ALL_JOINTS, planned.paths, preload_change=change)
    move = replace(
        _new_move(config, state.joints, press),
        force_fit=ForceFit(change.start),
        current_limit_A=preload_limit_A(config, state.joints, change),
    )
    return _accept(
        context,
        command,
        mode=Mode.PRELOAD,
        move=move,
        preload=change.start,
        planned_backlash_rad=planned.backlash_rad,
    )


def _begin_hold(config: Config, context: CommandContext, command: Hold) -> CommandContext:
    problem = check_ready(context) or check_mode(context, ModeEvent.MOVE_FREE)
    if problem is not None:
        return refuse(context, command, problem)
    mode = TRANSITIONS[context.state.mode, ModeEvent.MOVE_FREE]
    path = HoldPath(command.duration_s, context.state.joints.motor_rad)
    end_mode = TRANSITIONS[mode, ModeEvent.DONE]
    plan = MovePlan(command_name(command), end_mode, NO_JOINTS, (path,), vibrate=command.vibrate)
    return _accept(context, command, mode=mode, move=_new_move(config, context.state.joints, plan))


def _only(joint: int) -> Flags:
    only: Flags = np.arange(ALL_JOINTS.size) == joint
    return only


def _new_move(config: Config, joints: JointEstimate, plan: MovePlan) -> Move:
    return Move(plan, Setpoint(joints.motor_rad, np.zeros_like(joints.motor_rad)), config.current_limit_A)


def _accept(context: CommandContext, command: SequenceStep, *evrs: Evr, **changes: Any) -> CommandContext:
    """Accept a command, which changes these fields of the state."""
    context = replace(context, state=replace(context.state, **changes))
    return with_events(context, CommandAccepted(command_name(command)), *evrs)
