"""Series of measured poses of an arm, in the order of measurement."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.serial_arm.poses import Pose

STILL_RAD: Final = 1e-3
"""Largest motion of a joint since the last pose after which its direction counts as unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseSeries:
    """Joint angles that the arm read, with the target that the tracker measured."""

    name: str
    joint_rad: Array
    """Joint angles, shape (joints, n)."""
    direction: Array
    """Direction of each joint's last move: +1, -1 or 0, shape (joints, n)."""
    X_TM: Pose
    """Target M in the tracker's frame T, batch (n,)."""
    air_C: Array | None
    """Air temperature, shape (n,); None if unknown."""
    row: Integers
    """Row number of each pose in its table; the first row below the header is 1."""

    @property
    def count(self) -> int:
        """Return the number of poses."""
        return self.row.size

    def at(self, poses: Flags | Integers) -> "PoseSeries":
        """Select some of the poses; directions of moves stay those of the whole series.

        Args:
            poses: Flags, shape (n,), or indices, shape (k,).

        Returns:
            Series of the selected poses.
        """
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
    """Compute the direction of each joint's last move.

    Args:
        joint_rad: Joint angles in order of time, shape (joints, n).

    Returns:
        +1, -1 or 0, unitless, shape (joints, n).
    """
    motion = np.diff(joint_rad, axis=1, prepend=joint_rad[:, :1])
    return np.where(np.abs(motion) > STILL_RAD, np.sign(motion), 0.0)
