"""What is measured at a pose, made into a row of the campaign."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose, stack_poses
from ground.calibration.data import Believed, Campaign
from ground.calibration.frames import Built, built_frame, seen_from
from ground.calibration.screws import Measured
from sim.frames import P_NR_M
from sim.plant import Plant
from sim.tracker import GROUND_TARGETS, ROVER_TARGETS, TURRET_TARGETS, Tracker, measure_targets, rover_pose

X_NR: Final = Pose(np.eye(3), P_NR_M)
SWAY_RAD, SWAY_M = 2e-4, 1e-3
"""How far the rover moves on its suspension from pose to pose, one sigma an axis; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class Surveyed:
    """The turret in the rover, and how well the tracker saw."""

    X_RT: Pose
    covariance: Array
    targets_seen: tuple[int, int, int]
    misfit_m: float
    X_WG: Pose
    """The ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One pose, as flight software knows it (arrays (5,), (3,)) and as it was measured."""

    group: int
    branch: str
    motor_rad: Array
    gap_rad: Array
    held_Nm: Array
    side: Array
    gravity_R_m_s2: Array
    turret_kg: float
    seen: Surveyed


def surveyed(
    tracker: Tracker, plant: Plant, roll_rad: float, X_RF: Pose, rng: np.random.Generator
) -> Surveyed:
    """One look at the settled arm, its turret's interface at X_RF; the rover sways from look to look.

    Raises:
        FewTargets: too few targets on a body are in sight.
    """
    sway = rng.standard_normal(6) * np.repeat([SWAY_RAD, SWAY_M], 3)
    of_bodies = measure_targets(tracker, plant, rover_pose(roll_rad, sway), X_RF, rng)
    named = zip(
        (GROUND_TARGETS, ROVER_TARGETS, TURRET_TARGETS), of_bodies, ("ground", "rover", "turret"), strict=True
    )
    ground, rover, turret = (built_frame(targets, shot, name) for targets, shot, name in named)
    X_RT, covariance = seen_from(rover, turret, X_NR)
    frames = (ground, rover, turret)
    sigma = [shot.sigma_m[shot.visible] for shot in of_bodies]
    return Surveyed(
        X_RT, covariance, (ground.count, rover.count, turret.count), _misfit(frames, sigma), ground.X_WB
    )


def _misfit(frames: Sequence[Built], sigma_m: Sequence[Array]) -> float:
    """Root mean square of what does not fit, over all coordinates, as if six a frame had not been fitted."""
    squares = sum(float(np.sum((f.misfit * s) ** 2)) for f, s in zip(frames, sigma_m, strict=True))
    free = sum(3 * f.count - 6 for f in frames)
    return float(np.sqrt(squares / max(free, 1)))


def campaign_from(arm_name: str, rows: Sequence[Row]) -> Campaign:
    """The rows as one record."""

    def stacked(name: str) -> Array:
        return np.stack([getattr(row, name) for row in rows], axis=-1)

    names = ("motor_rad", "gap_rad", "held_Nm", "side", "gravity_R_m_s2")
    motor, gap, held, side, gravity = (stacked(name) for name in names)
    believed = Believed(motor, gap, held, side, gravity, np.array([row.turret_kg for row in rows]))
    ground = np.stack([row.seen.X_WG.p for row in rows], -1)
    return Campaign(
        arm_name=arm_name,
        group=np.array([row.group for row in rows]),
        branch=tuple(row.branch for row in rows),
        believed=believed,
        measured=Measured(
            stack_poses([row.seen.X_RT for row in rows]), np.stack([row.seen.covariance for row in rows])
        ),
        targets_seen=np.array([row.seen.targets_seen for row in rows]).T,
        misfit_m=np.array([row.seen.misfit_m for row in rows]),
        tracker_moved_m=np.linalg.norm(ground - ground[:, :1], axis=0),
    )
