"""What is measured at a pose, made into a row of the campaign."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose, adjoint, inverse, skew, stack_poses
from ground.calibration.campaign_data import BelievedPoses, Campaign
from ground.calibration.screws import MeasuredPoses
from sim.frames import P_NR_M
from sim.plant import Plant
from sim.tracker import (
    GROUND_TARGETS,
    ROVER_TARGETS,
    TURRET_TARGETS,
    TargetReadings,
    Tracker,
    TrackerTargets,
    measure_targets,
    rover_pose,
)

MIN_TARGETS: Final = 3
"""Targets that a frame can be built from, if they are not on one line."""
COLLINEARITY: Final = 1e-3
"""Targets are on one line if they are this close to it, as a share of their spread."""


class TooFewTargets(ValueError):
    """Too few targets were seen to build a frame."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """Where a body is."""

    X_WB: Pose
    covariance: Array
    """Of the screw from the true to the measured pose, in body axes, rotation first, (6, 6)."""
    misfit: Array
    """Where targets are beside where the rigid body has them, in units of their noise, (3, k)."""
    count: int


def fit_frame(targets: TrackerTargets, shots: TargetReadings, name: str) -> FrameFit:
    """The body's frame in the tracker's, from the targets seen: weighted least squares (Kabsch).

    Raises:
        FewTargets: fewer than three, or all on one line.
    """
    seen = shots.visible
    b, q, weight = targets.p_BoQ_B_m[:, seen], shots.p_WoQ_W_m[:, seen], shots.sigma_m[seen] ** -2
    count = int(np.count_nonzero(seen))
    if count < MIN_TARGETS:
        raise TooFewTargets(
            f"{name}: {count} targets seen; {MIN_TARGETS} that are not on one line are the least"
        )
    mid_b, mid_q = (np.average(p, axis=1, weights=weight) for p in (b, q))
    b_about, q_about = b - mid_b[:, None], q - mid_q[:, None]
    spread = np.linalg.svd(b_about * np.sqrt(weight), compute_uv=False)
    if spread[1] < COLLINEARITY * spread[0]:
        raise TooFewTargets(f"{name}: the {count} targets seen are on one line; one beside it is needed")
    U, _, Vt = np.linalg.svd((q_about * weight) @ b_about.T)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p = mid_q - R @ mid_b
    A = np.concatenate([-skew(b), np.repeat(np.eye(3)[:, :, None], count, axis=2)], axis=1)
    information = np.einsum("ijk,ilk,k->jl", A, A, weight)
    misfit = (q - (R @ b + p[:, None])) * np.sqrt(weight)
    return FrameFit(Pose(R, p), np.linalg.inv(information), misfit, count)


def turret_in_rover(rover: FrameFit, turret: FrameFit, X_NR: Pose) -> tuple[Pose, Array]:
    """X_RT with its covariance, in axes of T: the rover's motion is taken out with its frame.

    The rover's targets are known in RNAV; X_NR leads from there to RMECH.
    """
    X_NT = inverse(rover.X_WB) @ turret.X_WB
    from_N = adjoint(inverse(X_NT))
    covariance = turret.covariance + from_N @ rover.covariance @ from_N.T
    return inverse(X_NR) @ X_NT, covariance


X_NR: Final = Pose(np.eye(3), P_NR_M)
SWAY_RAD, SWAY_M = 2e-4, 1e-3
"""How far the rover moves on its suspension from pose to pose, one sigma an axis; assumed."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """The turret in the rover, and how well the tracker saw."""

    X_RT: Pose
    covariance: Array
    targets_seen: tuple[int, int, int]
    misfit_m: float
    X_WG: Pose
    """The ground."""


@dataclass(frozen=True, slots=True, eq=False)
class CampaignRow:
    """One pose, as flight software knows it (arrays (5,), (3,)) and as it was measured."""

    group: int
    branch: str
    motor_rad: Array
    backlash_rad: Array
    friction_Nm: Array
    side: Array
    gravity_R_m_s2: Array
    turret_kg: float
    measurement: PoseMeasurement


def measure_pose(
    tracker: Tracker, plant: Plant, roll_rad: float, X_RF: Pose, rng: np.random.Generator
) -> PoseMeasurement:
    """One look at the settled arm, its turret's interface at X_RF; the rover sways from look to look.

    Raises:
        FewTargets: too few targets on a body are in sight.
    """
    sway = rng.standard_normal(6) * np.repeat([SWAY_RAD, SWAY_M], 3)
    of_bodies = measure_targets(tracker, plant, rover_pose(roll_rad, sway), X_RF, rng)
    named = zip(
        (GROUND_TARGETS, ROVER_TARGETS, TURRET_TARGETS), of_bodies, ("ground", "rover", "turret"), strict=True
    )
    ground, rover, turret = (fit_frame(targets, shot, name) for targets, shot, name in named)
    X_RT, covariance = turret_in_rover(rover, turret, X_NR)
    frames = (ground, rover, turret)
    sigma = [shot.sigma_m[shot.visible] for shot in of_bodies]
    return PoseMeasurement(
        X_RT, covariance, (ground.count, rover.count, turret.count), _misfit(frames, sigma), ground.X_WB
    )


def _misfit(frames: Sequence[FrameFit], sigma_m: Sequence[Array]) -> float:
    """Root mean square of what does not fit, over all coordinates, as if six a frame had not been fitted."""
    squares = sum(float(np.sum((f.misfit * s) ** 2)) for f, s in zip(frames, sigma_m, strict=True))
    free = sum(3 * f.count - 6 for f in frames)
    return float(np.sqrt(squares / max(free, 1)))


def stack_rows(arm_name: str, rows: Sequence[CampaignRow]) -> Campaign:
    """The rows as one record."""

    def stacked(name: str) -> Array:
        return np.stack([getattr(row, name) for row in rows], axis=-1)

    names = ("motor_rad", "backlash_rad", "friction_Nm", "side", "gravity_R_m_s2")
    motor, gap, held, side, gravity = (stacked(name) for name in names)
    believed = BelievedPoses(motor, gap, held, side, gravity, np.array([row.turret_kg for row in rows]))
    ground = np.stack([row.measurement.X_WG.p for row in rows], -1)
    return Campaign(
        arm_name=arm_name,
        group=np.array([row.group for row in rows]),
        branch=tuple(row.branch for row in rows),
        believed=believed,
        measured=MeasuredPoses(
            stack_poses([row.measurement.X_RT for row in rows]),
            np.stack([row.measurement.covariance for row in rows]),
        ),
        targets_seen=np.array([row.measurement.targets_seen for row in rows]).T,
        misfit_m=np.array([row.measurement.misfit_m for row in rows]),
        tracker_moved_m=np.linalg.norm(ground - ground[:, :1], axis=0),
    )
