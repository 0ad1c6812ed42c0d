"""The mode machine: a pure table of what may follow what."""

from enum import IntEnum
from typing import Final

from fsw.dictionary.modes import Mode


class Event(IntEnum):
    """What can change the mode."""

    MOVE_FREE = 0
    MOVE_GUARDED = 1
    MOVE_BACK = 2
    DONE = 3
    FAULT = 4
    CLEAR = 5


TRANSITIONS: Final[dict[tuple[Mode, Event], Mode]] = {
    (Mode.STOWED, Event.MOVE_FREE): Mode.FREE_SPACE,
    (Mode.DEPLOYED, Event.MOVE_FREE): Mode.FREE_SPACE,
    (Mode.DEPLOYED, Event.MOVE_GUARDED): Mode.GUARDED,
    (Mode.DEPLOYED, Event.MOVE_BACK): Mode.RETRACTING,
    (Mode.GUARDED, Event.MOVE_GUARDED): Mode.GUARDED,
    (Mode.GUARDED, Event.MOVE_BACK): Mode.RETRACTING,
    (Mode.FREE_SPACE, Event.DONE): Mode.DEPLOYED,
    (Mode.GUARDED, Event.DONE): Mode.GUARDED,
    (Mode.RETRACTING, Event.DONE): Mode.DEPLOYED,
    (Mode.FAULTED, Event.CLEAR): Mode.DEPLOYED,
    **{(mode, Event.FAULT): Mode.FAULTED for mode in Mode},
}
"""A pair that is not here is refused."""


def after(mode: Mode, event: Event) -> Mode | None:
    """The next mode, or None if the event is not allowed in this one."""
    return TRANSITIONS.get((mode, event))
