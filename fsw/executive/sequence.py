"""Sequences of commands that follow from one command, each begun when the one before is done."""

from typing import Final

from fsw.dictionary.commands import Calibrate, MoveJoint
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.params import Params
from fsw.executive.hardstop_pose import AGAIN
from fsw.state import Sequence

CLEAR_ORDER: Final = (Joint.AZIMUTH, Joint.TURRET, Joint.WRIST, Joint.ELBOW, Joint.ELEVATION)
"""In which the joints go from their parking places to the last turn: sideways first, down last."""


def calibrate_all(params: Params, anew: bool = False) -> Sequence:
    """Each joint to its hardstop and then to where it waits for the others; one of them again at the end."""
    park, again = params.hardstop.park_rad, params.hardstop.again_rad
    turns = [(Calibrate(joint, anew), MoveJoint(joint, park[joint])) for joint in HARDSTOP_ORDER]
    ready = [MoveJoint(joint, again[joint]) for joint in CLEAR_ORDER if again[joint] != park[joint]]
    last = (Calibrate(AGAIN, anew), MoveJoint(AGAIN, park[AGAIN]))
    return Sequence("CalibrateAll", (*(command for turn in turns for command in turn), *ready, *last))
