"""Calibration of a serial arm from a series of poses: first estimate of base and target, fit, error terms.

`used` flags the poses that are fitted, (n,); values of parameters are (p,) in their units, by default 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.arrays import Array, Flags
from simgap.common.errors import RobotError
from simgap.serial_arm.chain import IDENTITY, Pose, PoseSeries, compose, forward_kinematics, norm, repeat_pose
from simgap.serial_arm.fit import Fit, fit, fit_without_outliers, validate_hold_out
from simgap.serial_arm.model import (
    NON_PERIODIC,
    SerialArm,
    SerialModel,
    TrackerSetup,
    serial_model,
)

LEAST_POSES: Final = 20
LEAST_TURN_RAD: Final = 0.2
"""Smallest spread of the rotation of the target about two axes; below it, base and target are confounded."""
MAX_ROTATION_ERROR_RAD: Final = 0.1
"""Largest median rotation error; a larger one is not an error of an arm."""
MAX_POSITION_ERROR_M: Final = 0.05


def estimate_setup(arm: SerialArm, series: PoseSeries) -> TrackerSetup:
    """Estimate the frames of base and target from poses of the nominal arm; RobotError if they do not fit it.

    R_TM = R_TB R_BF R_FM is bilinear in R_TB and R_FM. Both follow from the leading singular pair of the sum
    of Kronecker products of R_TM and R_BF (M. Shah, J. Mechanisms Robotics 5, 2013). Translations are
    then linear.
    """
    if series.count < LEAST_POSES:
        raise RobotError(f"{series.count} poses are too few; {LEAST_POSES} or more are wanted")
    ends, _ = forward_kinematics(repeat_pose(IDENTITY, series.count), arm.link_geometry, series.joint_rad)
    X_BF = ends[-1]
    _check_rotations(X_BF)
    R_TB, R_FM = _solve_rotations(series.X_TM.R, X_BF.R)
    R_TM = np.einsum("ij,jkn,kl->iln", R_TB, X_BF.R, R_FM)
    turned = np.trace(compose(np.swapaxes(series.X_TM.R, 0, 1), R_TM))
    rotation_error_rad = np.arccos(np.clip((turned - 1) / 2, -1.0, 1.0))
    if np.median(rotation_error_rad) > MAX_ROTATION_ERROR_RAD:
        raise RobotError(
            f"the target does not turn as the arm's flange does: half of the poses are off by "
            f"{np.degrees(np.median(rotation_error_rad)):.1f} deg or more; "
            "see that angles have their units, rotations the order "
            "that the tracker means, and joints the arm's names and signs"
        )
    setup = _solve_translations(series, X_BF, R_TB, R_FM)
    X_TM = repeat_pose(setup.X_TB, series.count) @ X_BF @ repeat_pose(setup.X_FM, series.count)
    position_error_m = norm(series.X_TM.p - X_TM.p)
    if np.median(position_error_m) > MAX_POSITION_ERROR_M:
        raise RobotError(
            f"the target does not move as the arm's flange does: half of the poses are off by "
            f"{np.median(position_error_m) * 1e3:.0f} mm or more; {_scale_words(series, X_BF)}"
        )
    return setup


def _check_rotations(X_BF: Pose) -> None:
    from_first = compose(np.swapaxes(X_BF.R, 0, 1), X_BF.R[:, :, :1])
    turns = Rotation.from_matrix(np.moveaxis(from_first, -1, 0)).as_rotvec().T
    spread = np.linalg.svd(turns - turns.mean(axis=1, keepdims=True), compute_uv=False)
    if spread[1] / np.sqrt(turns.shape[1]) < LEAST_TURN_RAD / 2:
        raise RobotError(
            "the poses are too much alike: the flange hardly turns about a second axis, so base and target "
            "cannot be told apart; give poses that turn by half a radian or more about two axes"
        )


def _solve_rotations(R_TM: Array, R_BF: Array) -> tuple[Array, Array]:
    both = np.einsum("ijn,kln->ikjl", R_TM, R_BF).reshape(9, 9)
    U, _, Vt = np.linalg.svd(both)
    R_TB, R_MF = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(R_TB))
    return _nearest_rotation(sign * R_TB), _nearest_rotation(sign * R_MF).T


def _nearest_rotation(M: Array) -> Array:
    U, _, Vt = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _solve_translations(series: PoseSeries, X_BF: Pose, R_TB: Array, R_FM: Array) -> TrackerSetup:
    """Find the translations with the least squared position errors."""
    R_TF = np.einsum("ij,jkn->ikn", R_TB, X_BF.R)
    rows = np.concatenate([np.broadcast_to(np.eye(3)[:, :, None], R_TF.shape), R_TF], axis=1)
    difference = series.X_TM.p - np.einsum("ij,jn->in", R_TB, X_BF.p)
    flat = np.moveaxis(rows, 2, 0).reshape(-1, 6)
    shifts = np.linalg.lstsq(flat, difference.T.ravel(), rcond=None)[0]
    return TrackerSetup(Pose(R_TB, shifts[:3]), Pose(R_FM, shifts[3:]))


def _scale_words(series: PoseSeries, X_BF: Pose) -> str:
    """Describe an error of units, if the motions differ in size."""
    measured, modelled = (np.sqrt(np.mean(np.var(p, axis=1))) for p in (series.X_TM.p, X_BF.p))
    if not 0.2 < measured / modelled < 5.0:
        return f"it moves {measured / modelled:.3g} times as far: see that positions have their unit"
    return "see that this is the arm of the file, and that positions and joints have their order and signs"


@dataclass(frozen=True, slots=True, eq=False)
class SerialCalibration:
    """Result of a calibration."""

    model: SerialModel
    fit: Fit

    @property
    def outliers(self) -> tuple[int, ...]:
        """Return the rows of the table that were left out because they do not agree with the others."""
        return tuple(int(row) for row in self.model.series.row[~self.fit.used])

    @property
    def arm(self) -> SerialArm:
        """Return the calibrated arm."""
        return self.model.at(self.fit.values)[0]

    @property
    def setup(self) -> TrackerSetup:
        """Return the calibrated setup."""
        return self.model.at(self.fit.values)[1]


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """Errors of an arm model at measured poses."""

    position_m: Array
    """Position error of the target, shape (n,)."""
    rotation_rad: Array
    """Rotation error of the target, shape (n,)."""

    @property
    def rms_m(self) -> float:
        """Compute the root mean square position error."""
        return float(np.sqrt(np.mean(self.position_m**2)))

    @property
    def rms_rad(self) -> float:
        """Compute the root mean square rotation error."""
        return float(np.sqrt(np.mean(self.rotation_rad**2)))


def calibrate_series(
    arm: SerialArm, setup: TrackerSetup, series: PoseSeries, terms: Sequence[str]
) -> SerialCalibration:
    """Fit an arm to poses and leave out outliers; RobotError if too many poses do not agree."""
    model = serial_model(arm, setup, series, terms)
    return SerialCalibration(model, fit_without_outliers(model.parameters, model))


def fit_poses(
    arm: SerialArm, setup: TrackerSetup, series: PoseSeries, terms: Sequence[str], used: Flags
) -> SerialCalibration:
    """Fit an arm to selected poses of a series."""
    model = serial_model(arm, setup, series, terms)
    return SerialCalibration(model, fit(model.parameters, model, None, used))


def pose_errors(arm: SerialArm, setup: TrackerSetup, series: PoseSeries) -> PoseErrors:
    """Compute the errors of an arm with this setup at the poses of a series."""
    model = serial_model(arm, setup, series, ())
    X = model.poses(np.zeros(12))
    turned = np.einsum("ijn,ijn->n", X.R, series.X_TM.R)
    angle = np.arccos(np.clip((turned - 1) / 2, -1.0, 1.0))
    return PoseErrors(norm(X.p - series.X_TM.p), angle)


def held_out_ratio(found: SerialCalibration, series: PoseSeries) -> float:
    """Compute the error of held-out poses over the error expected from noise and covariance."""
    fresh = serial_model(found.model.arm, found.model.setup, series, found.model.terms)
    return validate_hold_out(found.fit, fresh(found.fit.values)).ratio


@dataclass(frozen=True, slots=True, eq=False)
class JointTerms:
    """Calibrated errors of one joint."""

    name: str
    compliance_rad_per_Nm: float
    compliance_sigma: float
    hysteresis_rad: float
    hysteresis_sigma: float
    periodic_rms_rad: float
    """Root mean square periodic error at the measured poses."""
    periodic_peak_rad: float
    """Largest periodic error at the measured poses."""


def joint_errors(found: SerialCalibration) -> tuple[JointTerms, ...]:
    """Compute the errors of all joints, from the base outward."""
    arm, fit = found.arm, found.fit
    sigma = {parameter.name: float(s) for parameter, s in zip(fit.parameters, fit.sigma, strict=True)}
    errors = []
    for one, features in zip(arm.links, found.model.features, strict=True):
        waves = features[:, len(NON_PERIODIC) :] @ one.periodic_rad(found.model.orders).ravel()
        sigmas = [sigma.get(f"{one.name}.{term}", 0.0) for term in ("compliance", "hysteresis")]
        periodic = float(np.sqrt(np.mean(waves**2))), float(np.max(np.abs(waves)))
        own = (one.compliance_rad_per_Nm, sigmas[0], one.hysteresis_rad, sigmas[1])
        errors.append(JointTerms(one.name, *own, *periodic))
    return tuple(errors)
