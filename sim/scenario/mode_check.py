"""Check of a command sequence against the mode table before a run, to find commands that would be refused."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, get_args

from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
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
from fsw.executive.context import EVENT_OF, ModeEvent, next_mode
from sim.scenario.names import upper_snake

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
