"""Data of a calibration campaign: poses at rest, as believed by flight software and as measured."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array, Flags, Integers, select_targets
from marsarm.calibration.measured_poses import MeasuredPoses


@dataclass(frozen=True, slots=True, eq=False)
class BelievedPoses:
    """State of the arm at each pose as flight software knows it; joint arrays have shape (5, n)."""

    motor_rad: Array
    """Motor angles on the output side."""
    backlash_rad: Array
    """Positions of the outputs in their backlash; half the width at a flank."""
    friction_Nm: Array
    """Load that friction of the outputs carries, so that the gears do not carry it."""
    side: Array
    """+1 or -1 if the output certainly lies on that side of the backlash, 0 if it is uncertain."""
    gravity_R_m_s2: Array
    """Gravity in the rover frame, shape (3, n)."""
    turret_kg: Array
    """Mass of the stand-in turret, shape (n,); NaN for the arm's own turret."""

    def at(self, poses: Flags | Integers) -> "BelievedPoses":
        """Select some of the poses.

        Args:
            poses: Flags, shape (n,), or indices, shape (k,).

        Returns:
            The selected poses.
        """
        return select_targets(self, poses)


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Poses of one campaign in the order of measurement."""

    arm_name: str
    group: Integers
    """Index of the group of each pose, shape (n,)."""
    branch: tuple[str, ...]
    """Name of the inverse-kinematics branch of each pose."""
    believed: BelievedPoses
    measured: MeasuredPoses
    targets_seen: Integers
    """Number of targets on ground, rover and turret that the tracker saw, shape (3, n)."""
    misfit_m: Array
    """Root mean square distance of targets from a rigid body, shape (n,)."""
    tracker_moved_m: Array
    """Apparent motion of the ground targets since the first pose, shape (n,)."""

    @property
    def count(self) -> int:
        """Return the number of poses."""
        return self.group.size

    def at(self, poses: Flags | Integers) -> "Campaign":
        """Select some of the poses.

        Args:
            poses: Flags, shape (n,), or indices in the wanted order, shape (k,).

        Returns:
            Campaign of the selected poses.
        """
        where = np.flatnonzero(poses) if poses.dtype == bool else poses
        return Campaign(
            self.arm_name,
            self.group[where],
            tuple(self.branch[int(k)] for k in where),
            self.believed.at(where),
            MeasuredPoses(self.measured.X_RT[where], self.measured.covariance[where]),
            self.targets_seen[:, where],
            self.misfit_m[where],
            self.tracker_moved_m[where],
        )
