"""Enumerations of the dictionary, in the order in which every array lists their members."""

from enum import IntEnum
from typing import Final


class Mode(IntEnum):
    """Mode of the arm; fsw/executive/context.py defines the transitions."""

    STOWED = 0
    DEPLOYED = 1
    FREE_SPACE = 2
    GUARDED = 3
    RETRACTING = 4
    FAULTED = 5
    PRELOAD = 6
    """A tool presses on a surface, and only the force may change."""
    PLANNING = 7
    """A command is being planned; the arm rests on its brakes."""


class Joint(IntEnum):
    """The five joints, from the rover outward."""

    AZIMUTH = 0
    ELEVATION = 1
    ELBOW = 2
    WRIST = 3
    TURRET = 4


HARDSTOP_ORDER: Final = (Joint.TURRET, Joint.WRIST, Joint.ELEVATION, Joint.ELBOW, Joint.AZIMUTH)
"""Order in which the joints find their hardstops; the moves in this order stay clear of the rover."""


class Frame(IntEnum):
    """The seven frames of the kinematic chain (paper, section Propagating Source Errors)."""

    ARM1 = 0
    ARM2 = 1
    ARM3 = 2
    ARM4 = 3
    ARM5 = 4
    ARM6 = 5
    TOOL = 6
