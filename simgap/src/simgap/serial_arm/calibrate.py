"""Calibration of a serial arm from a series of poses, with the contributions of its error terms."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from simgap.arrays import Array, Flags
from simgap.common.errors import RobotError
from simgap.serial_arm.arm import SerialArm
from simgap.serial_arm.fit import Fit, fit, validate_hold_out
from simgap.serial_arm.model import (
    GEOMETRY,
    NON_PERIODIC,
    PERIODIC,
    SerialModel,
    TrackerSetup,
    serial_model,
)
from simgap.serial_arm.outliers import FALSE_ALARM, MAX_OUTLIER_SHARE, leave_one_out_distance
from simgap.serial_arm.poses import norm
from simgap.serial_arm.series import PoseSeries

COMPONENTS: Final = 6
"""Number of components of a pose."""
REJECTION_FACTOR: Final = 4.0
"""Poses whose squared distance is within this factor of the worst are left out together."""
MOST_ROUNDS: Final = 20
NOT_LINKS = ("base", "target")


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
    """Fit an arm to a series of poses and leave out outliers.

    A series may hold thousands of poses, so similarly bad outliers are left out together. Poses that agree
    with the next fit are included again.

    Args:
        arm: Arm before the calibration.
        setup: Initial base and target frames.
        series: Measured poses.
        terms: Terms to fit, of TERMS.

    Returns:
        The calibration.

    Raises:
        RobotError: Too many poses do not agree.
    """
    used = np.ones(series.count, bool)
    found = fit_poses(arm, setup, series, terms, used)
    for _ in range(MOST_ROUNDS):
        distance = leave_one_out_distance(found.fit)
        typical = max(1.0, float(np.median(distance[used])) / chi2.median(COMPONENTS))
        limit = typical * chi2.isf(FALSE_ALARM / series.count, COMPONENTS)
        agree = distance <= max(limit, float(distance[used].max()) / REJECTION_FACTOR)
        if np.array_equal(agree, used):
            break
        if np.count_nonzero(~agree) > MAX_OUTLIER_SHARE * series.count:
            raise RobotError(
                f"more than {MAX_OUTLIER_SHARE:.0%} of {series.count} poses do not agree with the rest: "
                "see that this is "
                "the arm of the file, and that the tracker kept its target"
            )
        used = agree
        found = fit_poses(arm, setup, series, terms, used, found.fit.values)
    return found


def fit_poses(
    arm: SerialArm,
    setup: TrackerSetup,
    series: PoseSeries,
    terms: Sequence[str],
    used: Flags,
    start: Array | None = None,
) -> SerialCalibration:
    """Fit an arm to selected poses of a series.

    Args:
        arm: Arm before the calibration.
        setup: Initial base and target frames.
        series: Measured poses.
        terms: Terms to fit, of TERMS.
        used: Boolean flags of the poses to fit, shape (n,).
        start: Initial values in the units of the parameters, shape (p,); zeros by default.

    Returns:
        The calibration.
    """
    model = serial_model(arm, setup, series, terms)
    return SerialCalibration(model, fit(model.parameters, model, start, used))


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
class JointError:
    """Calibrated errors of one joint."""

    name: str
    compliance_rad_per_Nm: float
    compliance_sigma: float
    hysteresis_rad: float
    hysteresis_sigma: float
    rms_rad: float
    """Root mean square periodic error at the measured poses."""
    peak_rad: float
    """Largest periodic error at the measured poses."""


def contributions_m(found: SerialCalibration) -> dict[str, float]:
    """Compute the root mean square motion of the target that each term causes."""
    fit, sigma_m = found.fit, found.model.arm.repeatability.position_m
    J = fit.at.jacobian[:, 3:]
    contributions = {}
    for term in found.model.terms:
        is_of_term = np.array([term_of(one.name) == term for one in fit.parameters])
        shift = J[:, :, is_of_term] @ fit.values[is_of_term] * sigma_m
        contributions[term] = float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))
    return contributions


def term_of(parameter: str) -> str | None:
    """Return the term of a parameter by its name; None for base and target."""
    place, _, number = parameter.rpartition(".")
    if place in NOT_LINKS:
        return None
    if number in NON_PERIODIC:
        return number
    return PERIODIC if number.startswith(("cos", "sin")) else GEOMETRY


def joint_errors(found: SerialCalibration) -> tuple[JointError, ...]:
    """Compute the errors of all joints, from the base outward."""
    arm, fit = found.arm, found.fit
    sigma = {parameter.name: float(s) for parameter, s in zip(fit.parameters, fit.sigma, strict=True)}
    errors = []
    for one, features in zip(arm.links, found.model.features, strict=True):
        waves = periodic_error_rad(features[:, len(NON_PERIODIC) :], one.periodic_rad(found.model.orders))
        errors.append(
            JointError(
                one.name,
                one.compliance_rad_per_Nm,
                sigma.get(f"{one.name}.compliance", 0.0),
                one.hysteresis_rad,
                sigma.get(f"{one.name}.hysteresis", 0.0),
                float(np.sqrt(np.mean(waves**2))),
                float(np.max(np.abs(waves))),
            )
        )
    return tuple(errors)


def periodic_error_rad(features: Array, amplitudes: Array) -> Array:
    """Compute the periodic error of a joint.

    Args:
        features: Cosines and sines, unitless, shape (n, k), k twice the number of orders.
        amplitudes: Amplitudes of cosines and sines [rad], shape (2, orders).

    Returns:
        Errors [rad], shape (n,).
    """
    waves: Array = features @ amplitudes.ravel()
    return waves
