"""What a campaign of calibration hands over: settled poses, as flight software knows them and as measured."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.batch import select_targets
from fsw.kinematics.transforms import Array, Flags, Integers
from ground.calibration.screws import MeasuredPoses


@dataclass(frozen=True, slots=True, eq=False)
class BelievedPoses:
    """What flight software knows of the poses; joint arrays (5, n) in the order of Joint."""

    motor_rad: Array
    """Motor angles, output side."""
    backlash_rad: Array
    """Where the outputs lie in their gaps; half the width on a flank."""
    friction_Nm: Array
    """What of the load the friction of the outputs holds, so that the gears do not carry it."""
    side: Array
    """+1 or -1 where the output surely lies on that side of its gap, 0 where it only probably does."""
    gravity_R_m_s2: Array
    """(3, n)."""
    turret_kg: Array
    """Mass of the stand-in turret, (n,); NaN for the arm's own turret."""

    def at(self, poses: Flags | Integers) -> "BelievedPoses":
        """Some of the poses."""
        return select_targets(self, poses)


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Poses of one campaign, in the order in which they were taken."""

    arm_name: str
    group: Integers
    """Which part of the campaign a pose belongs to, (n,)."""
    branch: tuple[str, ...]
    """Of the inverse kinematics, by name."""
    believed: BelievedPoses
    measured: MeasuredPoses
    targets_seen: Integers
    """How many targets on ground, rover and turret the tracker saw, (3, n)."""
    misfit_m: Array
    """Root mean square by which the targets seen were not where a rigid body has them, (n,)."""
    tracker_moved_m: Array
    """How far the ground's targets seem to have moved since the first pose, (n,)."""

    @property
    def count(self) -> int:
        """How many poses."""
        return self.group.size

    def at(self, poses: Flags | Integers) -> "Campaign":
        """Some of the poses, in order."""
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
