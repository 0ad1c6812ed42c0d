"""Targets of the inverse kinematics, and the names of its results."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.ik import BranchVerdict
from fsw.kinematics.transforms import Array
from marsarm.common.requests import TargetLabel, check_targets
from sim.frames import p_R_from_N
from simgap.common.errors import BadRequest

JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
VERDICT_NAMES: Final = tuple(verdict.name.lower() for verdict in BranchVerdict)
FRAMES: Final = ("rnav", "rmech")


@dataclass(frozen=True, slots=True, eq=False)
class IkTargets:
    """Targets: position of the tool's origin and direction of its boresight, in RMECH."""

    p_RoTo_R_m: Array
    """Positions, shape (3, n)."""
    approach_R: Array
    """Unit vectors, shape (3, n)."""

    def __len__(self) -> int:
        return int(self.p_RoTo_R_m.shape[1])

    def part(self, start: int, count: int) -> "IkTargets":
        """Select `count` targets from index `start` on."""
        these = slice(start, start + count)
        return IkTargets(self.p_RoTo_R_m[:, these], self.approach_R[:, these])


def make_targets(position_m: Array, approach: Array, frame: str, naming: TargetLabel) -> IkTargets:
    """Build targets in a frame of FRAMES of positions and directions of any length, shape (3, n) each.

    BadRequest, in the words of the user, says that a number is not finite, a point too far, a direction 0.
    """
    if frame not in FRAMES:
        raise BadRequest(f"frame: {frame!r} is not known; there are {', '.join(FRAMES)}")
    what = "the one in which the tool is to point, such as 0 0 1 for down"
    unit = check_targets(position_m, approach, naming, what)
    unit = unit / np.linalg.norm(unit, axis=0)
    return IkTargets(p_R_from_N(position_m.T).T if frame == "rnav" else position_m, unit)
