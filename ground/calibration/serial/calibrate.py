"""A serial arm fitted to one part of its poses and judged by another."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags, norm
from ground.calibration.fit import Fit, fit
from ground.calibration.judge import judged
from ground.calibration.outliers import FALSE_ALARM, MOST, NoAgreement, leave_out_distance
from ground.calibration.serial.arm import SerialArm
from ground.calibration.serial.model import SerialModel, Setup, serial_model
from ground.calibration.serial.series import Series

COMPONENTS: Final = 6
"""Of a pose."""
TOGETHER: Final = 4.0
"""Squared distances within this factor of the worst are left out at once."""
MOST_ROUNDS: Final = 20


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
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
    def setup(self) -> Setup:
        """As it is found to be."""
        return self.model.at(self.fit.values)[1]


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
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


def calibrate(arm: SerialArm, setup: Setup, series: Series, terms: Sequence[str]) -> Calibrated:
    """Fit to all poses of a series but those that do not belong to the others.

    The worst go first, all at once that are within a factor of each other, for there may be thousands; those
    that the next fit agrees with come back.

    Raises:
        NoAgreement: too many poses do not agree.
    """
    used = np.ones(series.count, bool)
    found = calibrate_to(arm, setup, series, terms, used)
    for _ in range(MOST_ROUNDS):
        distance = leave_out_distance(found.fit)
        typical = max(1.0, float(np.median(distance[used])) / chi2.median(COMPONENTS))
        limit = typical * chi2.isf(FALSE_ALARM / series.count, COMPONENTS)
        agree = distance <= max(limit, float(distance[used].max()) / TOGETHER)
        if np.array_equal(agree, used):
            break
        if np.count_nonzero(~agree) > MOST * series.count:
            raise NoAgreement(
                f"more than {MOST:.0%} of {series.count} poses do not agree with the rest: see that this is "
                "the arm of the file, and that the tracker kept its target"
            )
        used = agree
        found = calibrate_to(arm, setup, series, terms, used, found.fit.values)
    return found


def calibrate_to(
    arm: SerialArm,
    setup: Setup,
    series: Series,
    terms: Sequence[str],
    used: Flags,
    start: Array | None = None,
) -> Calibrated:
    """Fit to these poses (n,) of a series, from starting values if there are any."""
    model = serial_model(arm, setup, series, terms)
    return Calibrated(model, fit(model.parameters, model, start, used))


def verdict(arm: SerialArm, setup: Setup, series: Series) -> Verdict:
    """How far this arm, as it stands there, is from the poses of a series."""
    model = serial_model(arm, setup, series, ())
    X = model.poses(np.zeros(12))
    turned = np.einsum("ijn,ijn->n", X.R, series.X_TM.R)
    angle = np.arccos(np.clip((turned - 1) / 2, -1.0, 1.0))
    return Verdict(norm(X.p - series.X_TM.p), angle)


def misfit_ratio(found: Calibrated, series: Series) -> float:
    """What fresh poses are off by, over what noise and the covariance of the fit let expect."""
    fresh = serial_model(found.model.arm, found.model.setup, series, found.model.terms)
    return judged(found.fit, fresh(found.fit.values)).ratio
