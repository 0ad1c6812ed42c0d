"""Rehearsal of a scenario before a run: commands that would be refused, by the mode table and by the planner.

Flight software's planner plans every command, and nothing moves. Every command starts where the one before
it ends. A tool that is to touch a surface ends on it, without the overtravel. A taught point is where the
scenario has it.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, get_args

import numpy as np

from fsw.collision.geometry import TargetSurface
from fsw.config import Config, configure
from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
    Dock,
    GuardedMove,
    PlaceTool,
    Preload,
    Retract,
    SetParam,
    SetTilt,
    Stop,
    Stow,
    ToolChange,
)
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import TeachPoint
from fsw.dictionary.types import vector3
from fsw.estimate.joints import JointEstimate
from fsw.executive.context import (
    EVENT_OF,
    ModeEvent,
    check_arguments,
    check_force,
    next_mode,
    replace_param,
    tilt_joints,
)
from fsw.executive.expansion import CompoundCommand, locate_surface
from fsw.executive.planning import SingleMoveCommand, plan_sequence, plan_steps
from fsw.kinematics.transforms import normalize
from fsw.motion.plan import Refusal
from fsw.motion.preload import model_contact, plan_preload
from sim.arms import BuiltArm
from sim.frames import p_R_from_N
from sim.placement import first_estimate, joints_at
from sim.scenario.data import Scenario, TaughtPoint
from sim.scenario.records import upper_snake
from sim.setting import Surface
from sim.world import params_in_world

_FREE: Final = (ModeEvent.MOVE_FREE, ModeEvent.DONE)
_GUARDED: Final = (ModeEvent.MOVE_GUARDED, ModeEvent.DONE)
_BACK: Final = (ModeEvent.MOVE_BACK, ModeEvent.DONE)
_PRESS: Final = (ModeEvent.PRESS, ModeEvent.DONE)
_RELEASE: Final = (ModeEvent.PRESS, ModeEvent.DONE_RELEASED)

COMMAND_EVENTS: Final[dict[type[Command], tuple[ModeEvent, ...]]] = {
    **{kind: (event, ModeEvent.DONE) for kind, event in EVENT_OF.items()},
    Calibrate: _FREE,
    CalibrateAll: _FREE,
    Stow: (ModeEvent.MOVE_FREE, ModeEvent.DONE_STOWED),
    PlaceTool: (*_FREE, *_GUARDED),
    Preload: _PRESS,
    ToolChange: (*_BACK, *_FREE, *_GUARDED),
    SetTilt: (),
    SetParam: (),
    Stop: (),
    ClearFault: (ModeEvent.CLEAR,),
}
"""Mode events of a command that succeeds; `_events` has those that depend on arguments."""


Modes = frozenset[Mode]

_CLEARED: Final[Modes] = frozenset(
    Mode(mode) for event in ModeEvent if (mode := next_mode(Mode.FAULTED, event)) not in (None, Mode.FAULTED)
)
"""Modes after a fault is cleared; which one depends on the position of the arm, which is not known here."""


@dataclass(frozen=True, slots=True)
class SequenceState:
    """State of a sequence before a command."""

    modes: Modes
    """Possible modes."""
    tool: str | None = None
    """Tool that touches, if it is known."""
    faulted_in: int | None = None
    """Number of the command that an injected fault ended."""


def find_refusals(
    commands: Sequence[Command], start: Mode, faulting: Collection[int] = (), troubled: Collection[int] = ()
) -> Iterator[tuple[int, str]]:
    """Find the commands that would be refused.

    Args:
        start: Mode before the commands.
        faulting: Numbers of commands that certainly end in a fault, if they move.
        troubled: Numbers of commands that may end in a fault.

    Yields:
        The number of each refused command, and what would be right.
    """
    before = SequenceState(frozenset({start}))
    for number, command in enumerate(commands, 1):
        problem = _refusal_reason(before, command)
        if problem is not None:
            yield number, problem
        before = _next_state(before, command, number if number in faulting else None)
        if number in troubled and is_motion(command):
            before = replace(before, modes=before.modes | {Mode.FAULTED})


def is_motion(command: Command) -> bool:
    """Return whether a command moves the arm."""
    return COMMAND_EVENTS[type(command)] not in ((), (ModeEvent.CLEAR,))


def modes_after(modes: Modes, command: Command) -> Modes:
    """Return the modes in which a command may leave the arm; none if it may not begin."""
    if isinstance(command, ClearFault):
        return _CLEARED if Mode.FAULTED in modes else frozenset()
    if isinstance(command, ToolChange):
        modes &= {Mode.GUARDED}  # a tool that touches nothing may retract, but there is no point to return to
    return _apply_events(modes, _events(command))


def _apply_events(modes: Modes, events: tuple[ModeEvent, ...]) -> Modes:
    for event in events:
        modes = frozenset(reached for mode in modes if (reached := next_mode(mode, event)) is not None)
    return modes


def _events(command: Command) -> tuple[ModeEvent, ...]:
    match command:
        case Preload(force_N=force):
            return _RELEASE if force == 0 else _PRESS
        case ToolChange(hover_m=hover) if hover > 0:
            return (*_BACK, *_FREE)
        case _:
            return COMMAND_EVENTS[type(command)]


def _refusal_reason(before: SequenceState, command: Command) -> str | None:
    name, modes = upper_snake(type(command)), before.modes
    if modes == {Mode.FAULTED} and not isinstance(command, ClearFault | Stop):
        asks = "asks for motion" if is_motion(command) else "comes"
        return (
            f"{name} {asks} while the fault of command {before.faulted_in} stands; put CLEAR_FAULT before it"
        )
    if not modes_after(modes, command):
        if isinstance(command, ClearFault):
            return f"{name}: no fault is known to stand; leave it out, or inject a fault during a command"
        # a possible fault would have ended the sequence
        here = " or ".join(mode.name for mode in sorted(modes - {Mode.FAULTED}))
        return f"{name} is refused in mode {here}; before it comes {_enabling_commands(modes, command)}"
    if isinstance(command, ToolChange) and command.tool == before.tool:
        return f"{name}: {command.tool} is the tool that touches already; name another"
    wrong_tool = isinstance(command, GuardedMove | Retract | Preload) and command.tool != before.tool
    if wrong_tool and before.tool is not None:
        touching = before.tool
        return f"{name}: {touching} is the tool that touches; write {touching}"
    return None


def _next_state(before: SequenceState, command: Command, fault: int | None) -> SequenceState:
    if fault is not None and is_motion(command):
        return SequenceState(frozenset({Mode.FAULTED}), faulted_in=fault)
    if before.modes == {Mode.FAULTED} and not isinstance(command, ClearFault):
        return before
    # a refusal was reported already; continue as if the missing command had been there
    modes = modes_after(before.modes, command) or modes_after(frozenset(Mode), command)
    if not modes <= {Mode.GUARDED, Mode.PRELOAD}:
        return SequenceState(modes, faulted_in=before.faulted_in)
    if isinstance(command, GuardedMove | PlaceTool | ToolChange):
        return replace(before, modes=modes, tool=command.tool)
    return replace(before, modes=modes)


def _enabling_commands(modes: Modes, command: Command) -> str:
    """List the commands that lead to a mode in which this one may begin."""
    fit = frozenset(mode for mode in Mode if modes_after(frozenset({mode}), command))
    ways = [
        upper_snake(kind) + (" of force 0" if events is _RELEASE else "")
        for kind in get_args(Command)
        for events in ((_PRESS, _RELEASE) if kind is Preload else (COMMAND_EVENTS[kind],))
        if events and kind not in (ClearFault, ToolChange) and _apply_events(modes, events) & fit
    ]
    return " or ".join(ways) or f"what leads to mode {' or '.join(mode.name for mode in sorted(fit))}"


MotionCommand = CompoundCommand | SingleMoveCommand


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsed:
    """Knowledge of flight software before a command."""

    config: Config
    joints: JointEstimate
    tool: str
    surface: TargetSurface | None


def find_impossible(scenario: Scenario, arm: BuiltArm) -> str | None:
    """Return the first command of a scenario that flight software cannot plan and the reason, or None."""
    taught = tuple(_nominal_point(point) for point in scenario.taught)
    params = params_in_world(scenario.world, replace(arm.params, teach=(*arm.params.teach, *taught)))
    config = configure(params)
    start_rad = params.poses.stowed_rad if scenario.start == "stowed" else params.poses.ready_rad
    joints = first_estimate(config, np.array(start_rad), scenario.world.gravity_N_m_s2)
    before = Rehearsed(config, joints, params.tool_names[0], None)
    for number, command in enumerate(scenario.commands, 1):
        ended = _rehearse(before, command, scenario.world.surface)
        if isinstance(ended, Refusal):
            return f"command {number}, {upper_snake(type(command))}: {ended.reason}"
        if ended is None:
            return None
        before = ended
    return None


def _rehearse(before: Rehearsed, command: Command, surface: Surface | None) -> Rehearsed | Refusal | None:
    """Plan a command, and return what is known after it; None if that is nothing."""
    config, joints = before.config, before.joints
    problem = check_arguments(config.params, command)
    if problem is not None:
        return Refusal(problem)
    match command:
        case Stop():
            return before
        case ClearFault():
            return None  # where a fault stops the arm is not known before
        case SetTilt():
            tilted = tilt_joints(config, joints, command)
            return Refusal(tilted) if isinstance(tilted, str) else replace(before, joints=tilted[0])
        case SetParam():
            changed = replace_param(config.params, command)
            if isinstance(changed, str):
                return Refusal(changed)
            return replace(before, config=configure(changed))
        case CalibrateAll():
            return replace(before, joints=joints_at(joints, np.array(config.params.hardstop.park_rad)))
        case Calibrate():
            at_stop = np.array([joint.hardstop_rad for joint in config.params.joints.in_order()])
            moved = np.arange(at_stop.size) == command.joint
            return replace(before, joints=joints_at(joints, np.where(moved, at_stop, joints.output_rad)))
        case Preload():
            refused = _refuse_preload(before, command)
            return before if refused is None else refused
        case _:
            planned, ending = _plan_motion(before, command), _end_on_surface(command, surface)
            keeps = isinstance(planned, Refusal) or ending is command
            return planned if keeps else _plan_motion(before, ending)


def _plan_motion(before: Rehearsed, command: MotionCommand) -> Rehearsed | Refusal:
    """Plan a motion, and return what is known after it."""
    config, joints, tool = before.config, before.joints, before.tool
    surface = locate_surface(config, joints, tool, command, before.surface)
    if isinstance(command, CompoundCommand):
        planned = plan_sequence(config, joints, tool, command, surface)
    else:
        planned = plan_steps(config, joints, tool, (command,), surface)
    if isinstance(planned, Refusal):
        return planned
    return Rehearsed(config, planned.joints, planned.tool, planned.surface)


def _refuse_preload(before: Rehearsed, command: Preload) -> Refusal | None:
    """Return the reason that the force cannot be reached from a touch; a release is always possible."""
    problem = check_force(before.config.params, command)
    if problem is not None:
        return Refusal(problem)
    touch = model_contact(before.config, before.joints, command.tool)
    if command.force_N <= touch.force_N:
        return None
    planned = plan_preload(before.config, before.joints, touch, command.force_N)
    return planned if isinstance(planned, Refusal) else None


def _end_on_surface(command: MotionCommand, surface: Surface | None) -> MotionCommand:
    """Return a motion that ends where its tool is to touch; without a touch, the motion itself."""
    match command:
        case PlaceTool() | Dock():
            return replace(command, overtravel_m=0.0)
        case ToolChange(hover_m=0.0):
            return replace(command, overtravel_m=0.0)
        case GuardedMove() if surface is not None:
            end, approach = np.array(command.end_p_RoTo_R_m), normalize(np.array(command.approach_R))
            normal = normalize(np.array(surface.normal_N))
            above_m = float((end - p_R_from_N(np.array(surface.p_N_m))) @ normal)
            into = float(approach @ normal)
            if above_m < 0 and into < 0:
                return replace(command, end_p_RoTo_R_m=vector3(end - above_m / into * approach))
    return command


def _nominal_point(point: TaughtPoint) -> TeachPoint:
    return TeachPoint(
        name=point.name,
        tool=point.tool,
        p_RoTo_R_m=vector3(p_R_from_N(np.array(point.p_N_m))),
        approach_R=vector3(normalize(np.array(point.approach_N))),
        branch=point.branch,
    )
