"""How much each effect that was found amounts to: at the target, and at the joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags, norm
from ground.calibration.fit import Fit, fit, validate_hold_out
from ground.calibration.outliers import (
    FALSE_ALARM,
    MAX_OUTLIER_SHARE,
    TooManyOutliers,
    leave_one_out_distance,
)
from ground.calibration.serial.arm import SerialArm
from ground.calibration.serial.model import (
    GEOMETRY,
    NON_PERIODIC,
    PERIODIC,
    SerialModel,
    TrackerSetup,
    serial_model,
)
from ground.calibration.serial.series import PoseSeries

COMPONENTS: Final = 6
"""Of a pose."""
REJECTION_FACTOR: Final = 4.0
"""Squared distances within this factor of the worst are left out at once."""
MOST_ROUNDS: Final = 20


@dataclass(frozen=True, slots=True, eq=False)
class SerialCalibration:
    """What was found."""

    model: SerialModel
    fit: Fit

    @property
    def outliers(self) -> tuple[int, ...]:
        """Rows of the table that do not agree with the others and were left out."""
        return tuple(int(row) for row in self.model.series.row[~self.fit.used])

    @property
    def arm(self) -> SerialArm:
        """As it is found to be."""
        return self.model.at(self.fit.values)[0]

    @property
    def setup(self) -> TrackerSetup:
        """As it is found to be."""
        return self.model.at(self.fit.values)[1]


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """How far a calibrated arm is from measured poses."""

    position_m: Array
    """Distance of the target, (n,)."""
    rotation_rad: Array
    """(n,)."""

    @property
    def rms_m(self) -> float:
        """Of position."""
        return float(np.sqrt(np.mean(self.position_m**2)))

    @property
    def rms_rad(self) -> float:
        """Of rotation."""
        return float(np.sqrt(np.mean(self.rotation_rad**2)))


def calibrate_series(
    arm: SerialArm, setup: TrackerSetup, series: PoseSeries, terms: Sequence[str]
) -> SerialCalibration:
    """Fit to all poses of a series but those that do not belong to the others.

    The worst go first, all at once that are within a factor of each other, for there may be thousands; those
    that the next fit agrees with come back.

    Raises:
        NoAgreement: too many poses do not agree.
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
            raise TooManyOutliers(
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
    """Fit to these poses (n,) of a series, from starting values if there are any."""
    model = serial_model(arm, setup, series, terms)
    return SerialCalibration(model, fit(model.parameters, model, start, used))


def pose_errors(arm: SerialArm, setup: TrackerSetup, series: PoseSeries) -> PoseErrors:
    """How far this arm, as it stands there, is from the poses of a series."""
    model = serial_model(arm, setup, series, ())
    X = model.poses(np.zeros(12))
    turned = np.einsum("ijn,ijn->n", X.R, series.X_TM.R)
    angle = np.arccos(np.clip((turned - 1) / 2, -1.0, 1.0))
    return PoseErrors(norm(X.p - series.X_TM.p), angle)


def held_out_ratio(found: SerialCalibration, series: PoseSeries) -> float:
    """What fresh poses are off by, over what noise and the covariance of the fit let expect."""
    fresh = serial_model(found.model.arm, found.model.setup, series, found.model.terms)
    return validate_hold_out(found.fit, fresh(found.fit.values)).ratio


NOT_LINKS = ("base", "target")


@dataclass(frozen=True, slots=True, eq=False)
class JointError:
    """What was found of one joint."""

    name: str
    compliance_rad_per_Nm: float
    compliance_sigma: float
    approach_rad: float
    approach_sigma: float
    rms_rad: float
    """Of its waves at the angles of the poses."""
    peak_rad: float
    """Largest of them."""


def contributions_m(found: SerialCalibration) -> dict[str, float]:
    """By how much each term moves the target, root mean square over the poses of the fit."""
    fit, sigma_m = found.fit, found.model.arm.repeats.position_m
    J = fit.at.jacobian[:, 3:]
    names = [parameter.name.split(".") for parameter in fit.parameters]
    amounts = {}
    for term in found.model.terms:
        mine = np.array([_term_of(*name) == term for name in names])
        shift = J[:, :, mine] @ fit.values[mine] * sigma_m
        amounts[term] = float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))
    return amounts


def _term_of(place: str, number: str) -> str | None:
    """Which term a parameter is of; base and target are of none."""
    if place in NOT_LINKS:
        return None
    if number in NON_PERIODIC:
        return number
    return PERIODIC if number.startswith(("cos", "sin")) else GEOMETRY


def joint_errors(found: SerialCalibration) -> tuple[JointError, ...]:
    """Of all joints, from the base outward."""
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
                one.approach_rad,
                sigma.get(f"{one.name}.approach", 0.0),
                float(np.sqrt(np.mean(waves**2))),
                float(np.max(np.abs(waves))),
            )
        )
    return tuple(errors)


def periodic_error_rad(features: Array, amplitudes: Array) -> Array:
    """A joint's waves (n,), from cosines and sines (n, 2 orders) and their amplitudes (2, orders)."""
    waves: Array = features @ amplitudes.ravel()
    return waves
