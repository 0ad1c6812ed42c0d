"""Poses of an arm that a tracker measured, in the order in which they were taken."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags, Integers, Pose

STILL_RAD: Final = 1e-3
"""A joint that moved less since the pose before has not shown from which side it came."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseSeries:
    """Joint angles as the arm read them, and its target as the tracker saw it."""

    name: str
    joint_rad: Array
    """(joints, n)."""
    direction: Array
    """+1, -1 or 0: the direction of each joint's last move, (joints, n)."""
    X_TM: Pose
    """The target M in the tracker's frame T, batch (n,)."""
    air_C: Array | None
    """(n,)."""
    row: Integers
    """What each pose is called in its table: the first row below the header is 1."""

    @property
    def count(self) -> int:
        """How many poses."""
        return self.row.size

    def at(self, poses: Flags | Integers) -> "PoseSeries":
        """Some of the poses; from where each was reached stays known."""
        air = None if self.air_C is None else self.air_C[poses]
        return PoseSeries(
            self.name,
            self.joint_rad[:, poses],
            self.direction[:, poses],
            self.X_TM[poses],
            air,
            self.row[poses],
        )


def move_directions(joint_rad: Array) -> Array:
    """The direction of each joint's last move, from angles (joints, n) in order of time."""
    moved = np.diff(joint_rad, axis=1, prepend=joint_rad[:, :1])
    return np.where(np.abs(moved) > STILL_RAD, np.sign(moved), 0.0)
