"""The modes of the arm."""

from enum import IntEnum


class Mode(IntEnum):
    """What the arm is doing; which events change it is in fsw/executive/modes.py."""

    STOWED = 0
    DEPLOYED = 1
    FREE_SPACE = 2
    GUARDED = 3
    RETRACTING = 4
    FAULTED = 5
    PRELOAD = 6
    """A tool is pressed on something; it moves only to press more or less."""
