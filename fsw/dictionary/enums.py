"""Enumerations of the dictionary, in the order in which every array lists their members."""

from enum import IntEnum
from typing import Final


class Mode(IntEnum):
    """Mode of the arm; fsw/executive/modes.py defines the transitions."""

    STOWED = 0
    DEPLOYED = 1
    FREE_SPACE = 2
    GUARDED = 3
    RETRACTING = 4
    FAULTED = 5
    PRELOAD = 6
    """A tool presses on a surface, and only the force may change."""


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


class Tool(IntEnum):
    """The tools on the turret."""

    DRILL = 0
    DRT = 1
    MAHLI = 2
    APXS = 3
    PORTION = 4


class Switch(IntEnum):
    """The contact switches, one bit each in the sensor word."""

    APXS_1 = 0
    APXS_2 = 1
    DRILL_1 = 2
    DRILL_2 = 3
    MAHLI_1A = 4
    MAHLI_1B = 5
    MAHLI_2A = 6
    MAHLI_2B = 7
    DRT_1 = 8
    DRT_2 = 9


TOOL_SWITCHES: Final[dict[Tool, tuple[Switch, ...]]] = {
    Tool.DRILL: (Switch.DRILL_1, Switch.DRILL_2),
    Tool.DRT: (Switch.DRT_1, Switch.DRT_2),
    Tool.MAHLI: (Switch.MAHLI_1A, Switch.MAHLI_1B, Switch.MAHLI_2A, Switch.MAHLI_2B),
    Tool.APXS: (Switch.APXS_1, Switch.APXS_2),
    Tool.PORTION: (),
}
"""Contact switches of each tool."""
