"""The mode machine: a pure table of what may follow what."""

from enum import IntEnum
from typing import Final

from fsw.dictionary.commands import (
    Command,
    Dock,
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
from fsw.dictionary.enums import Mode


class Event(IntEnum):
    """What can change the mode."""

    UNSTOW = 0
    MOVE_FREE = 1
    MOVE_GUARDED = 2
    MOVE_BACK = 3
    DONE = 4
    FAULT = 5
    CLEAR = 6
    CLEAR_STOWED = 7
    """Cleared in the stowed pose."""
    CLEAR_TOUCHING = 8
    """Cleared where the arm touches or may touch."""
    STOP = 9
    """A stop was commanded; a guarded or retracting arm may still touch."""
    STOP_STOWED = 10
    """A stop was commanded before the arm had left the stowed pose."""
    DONE_STOWED = 11
    """A move came to its end in the stowed pose."""
    PRESS = 12
    DONE_RELEASED = 13
    """A tool no longer presses; it still touches."""
    CLEAR_PRESSED = 14
    """Cleared where a tool may press."""


TRANSITIONS: Final[dict[tuple[Mode, Event], Mode]] = {
    (Mode.STOWED, Event.UNSTOW): Mode.FREE_SPACE,
    (Mode.DEPLOYED, Event.MOVE_FREE): Mode.FREE_SPACE,
    (Mode.DEPLOYED, Event.MOVE_GUARDED): Mode.GUARDED,
    (Mode.DEPLOYED, Event.MOVE_BACK): Mode.RETRACTING,
    (Mode.GUARDED, Event.MOVE_GUARDED): Mode.GUARDED,
    (Mode.GUARDED, Event.MOVE_BACK): Mode.RETRACTING,
    (Mode.FREE_SPACE, Event.DONE): Mode.DEPLOYED,
    (Mode.GUARDED, Event.DONE): Mode.GUARDED,
    (Mode.RETRACTING, Event.DONE): Mode.DEPLOYED,
    (Mode.FAULTED, Event.CLEAR): Mode.DEPLOYED,
    (Mode.FAULTED, Event.CLEAR_STOWED): Mode.STOWED,
    (Mode.FAULTED, Event.CLEAR_TOUCHING): Mode.GUARDED,
    (Mode.FREE_SPACE, Event.STOP): Mode.DEPLOYED,
    (Mode.FREE_SPACE, Event.STOP_STOWED): Mode.STOWED,
    (Mode.GUARDED, Event.STOP): Mode.GUARDED,
    (Mode.RETRACTING, Event.STOP): Mode.GUARDED,
    (Mode.FREE_SPACE, Event.DONE_STOWED): Mode.STOWED,
    (Mode.GUARDED, Event.PRESS): Mode.PRELOAD,
    (Mode.PRELOAD, Event.PRESS): Mode.PRELOAD,
    (Mode.PRELOAD, Event.DONE): Mode.PRELOAD,
    (Mode.PRELOAD, Event.DONE_RELEASED): Mode.GUARDED,
    (Mode.PRELOAD, Event.STOP): Mode.PRELOAD,
    (Mode.FAULTED, Event.CLEAR_PRESSED): Mode.PRELOAD,
    **{(mode, Event.FAULT): Mode.FAULTED for mode in Mode},
}
"""A pair that is not here is refused."""

EVENT_OF: Final[dict[type[Command], Event]] = {
    Unstow: Event.UNSTOW,
    Stow: Event.MOVE_FREE,
    MoveJoint: Event.MOVE_FREE,
    MoveJoints: Event.MOVE_FREE,
    MoveTool: Event.MOVE_FREE,
    GuardedMove: Event.MOVE_GUARDED,
    Retract: Event.MOVE_BACK,
    PlaceTool: Event.MOVE_FREE,
    ToolChange: Event.MOVE_BACK,
    MoveTeachPoint: Event.MOVE_FREE,
    Dock: Event.MOVE_GUARDED,
    Process: Event.MOVE_FREE,
}
"""What a move begins with."""


def after(mode: Mode, event: Event) -> Mode | None:
    """The next mode, or None if the event is not allowed in this one."""
    return TRANSITIONS.get((mode, event))
