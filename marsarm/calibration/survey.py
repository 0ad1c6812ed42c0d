"""Measurement of a pose by the tracker, and assembly of poses into a campaign."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose, adjoint, inverse, skew, stack_poses
from marsarm.calibration.campaign_data import BelievedPoses, Campaign
from marsarm.calibration.measured_poses import MeasuredPoses
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
"""Smallest number of targets that defines a frame; they must not be on one line."""
COLLINEARITY: Final = 1e-3
"""Targets count as collinear if they are this close to a line, as a share of their spread."""
X_NR: Final = Pose(np.eye(3), P_NR_M)
SWAY_RAD, SWAY_M = 2e-4, 1e-3
"""Motion of the rover on its suspension from pose to pose, one sigma an axis; assumed."""


class TooFewTargets(ValueError):
    """Error: too few targets were seen to define a frame."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """Pose of a body from its targets."""

    X_WB: Pose
    covariance: Array
    """Covariance of the screw from true to measured pose, in body axes, rotation first, (6, 6)."""
    misfit: Array
    """Measured less fitted target positions, in units of their noise, shape (3, k)."""
    count: int


def fit_frame(targets: TrackerTargets, shots: TargetReadings, name: str) -> FrameFit:
    """Fit the body's frame in the tracker's frame to the visible targets: weighted least squares (Kabsch).

    Raises:
        TooFewTargets: Fewer than three targets are visible, or all are on one line.
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
    """Compute the turret pose in the rover; the rover's own motion cancels.

    Args:
        rover: Rover frame, whose targets are known in RNAV (N).
        X_NR: Frame RMECH (R) in RNAV.

    Returns:
        X_RT, and its covariance in axes of T, rotation first, shape (6, 6).
    """
    X_NT = inverse(rover.X_WB) @ turret.X_WB
    from_N = adjoint(inverse(X_NT))
    covariance = turret.covariance + from_N @ rover.covariance @ from_N.T
    return inverse(X_NR) @ X_NT, covariance


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """Measured turret pose in the rover, with the quality of the measurement."""

    X_RT: Pose
    covariance: Array
    targets_seen: tuple[int, int, int]
    misfit_m: float
    X_WG: Pose
    """Frame of the ground targets in the tracker's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class CampaignRow:
    """One pose: state known to flight software and measurement.

    Joint arrays have shape (5,), gravity has shape (3,).
    """

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
    """Measure the arm at rest; the rover sways between measurements.

    Args:
        tracker: Tracker with its noise.
        plant: Plant that shows the arm.
        roll_rad: Roll of the rover.
        X_RF: Interface of the turret in the rover frame.

    Returns:
        The measurement.

    Raises:
        TooFewTargets: The tracker sees too few targets on a body.
    """
    sway = rng.standard_normal(6) * np.repeat([SWAY_RAD, SWAY_M], 3)
    readings = measure_targets(tracker, plant, rover_pose(roll_rad, sway), X_RF, rng)
    named = zip(
        (GROUND_TARGETS, ROVER_TARGETS, TURRET_TARGETS), readings, ("ground", "rover", "turret"), strict=True
    )
    ground, rover, turret = (fit_frame(targets, shot, name) for targets, shot, name in named)
    X_RT, covariance = turret_in_rover(rover, turret, X_NR)
    frames = (ground, rover, turret)
    sigma = [shot.sigma_m[shot.visible] for shot in readings]
    return PoseMeasurement(
        X_RT, covariance, (ground.count, rover.count, turret.count), _misfit(frames, sigma), ground.X_WB
    )


def _misfit(frames: Sequence[FrameFit], sigma_m: Sequence[Array]) -> float:
    """Compute the root mean square misfit of coordinates, corrected for six fitted numbers for each frame."""
    squares = sum(float(np.sum((f.misfit * s) ** 2)) for f, s in zip(frames, sigma_m, strict=True))
    free = sum(3 * f.count - 6 for f in frames)
    return float(np.sqrt(squares / max(free, 1)))


def stack_rows(arm_name: str, rows: Sequence[CampaignRow]) -> Campaign:
    """Stack rows into a campaign."""

    def stacked(name: str) -> Array:
        return np.stack([getattr(row, name) for row in rows], axis=-1)

    names = ("motor_rad", "backlash_rad", "friction_Nm", "side", "gravity_R_m_s2")
    motor, backlash, friction, side, gravity = (stacked(name) for name in names)
    believed = BelievedPoses(
        motor, backlash, friction, side, gravity, np.array([row.turret_kg for row in rows])
    )
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
