"""Poses that do not belong to the others: found one by one, named, left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from ground.calibration.fit import Fit, FitParameter, ResidualModel, fit

FALSE_ALARM: Final = 0.01
"""Probability that a campaign without any outlier is said to have one."""
MAX_OUTLIER_SHARE: Final = 0.2
"""Share of the poses: if more do not fit, it is not they that are wrong."""


class TooManyOutliers(ValueError):
    """More poses are outliers than outliers can be."""


@dataclass(frozen=True, slots=True, eq=False)
class OutlierRejection:
    """A fit without its outliers."""

    fit: Fit
    distance: Array
    """Of each pose from what the others predict, squared, in units of its variance, (n,)."""
    limit: Array
    """Of that distance, (n,)."""

    @property
    def outliers(self) -> tuple[int, ...]:
        """The poses left out."""
        return tuple(int(pose) for pose in np.flatnonzero(~self.fit.used))


def reject_outliers(
    parameters: Sequence[FitParameter],
    model: ResidualModel,
    start: Array | None = None,
    used: Flags | None = None,
    false_alarm: float = FALSE_ALARM,
) -> OutlierRejection:
    """Fit, leave out the worst pose beyond the limit, fit again, until all that is left agrees.

    A pose left out that the last fit agrees with comes back. Noise that is larger than stated, in all poses,
    raises the limit: it makes no outliers. With `used`, the other poses are left out from the beginning.

    Raises:
        NoAgreement: too many poses would have to go.
    """
    found = fit(parameters, model, start, used)
    asked = found.used
    count = int(np.count_nonzero(asked))
    while True:
        share, limit = _share_of_limit(found, false_alarm / count)
        worst = int(np.argmax(np.where(found.used, share, -np.inf)))
        if share[worst] <= 1.0:
            break
        keep = found.used & (np.arange(share.size) != worst)
        if np.count_nonzero(asked & ~keep) > MAX_OUTLIER_SHARE * count:
            raise TooManyOutliers(
                f"more than {MAX_OUTLIER_SHARE:.0%} of {count} poses do not agree with the rest: no arm "
                "explains them all"
            )
        found = fit(parameters, model, found.values, keep)
    back = asked & ~found.used & (share <= 1.0)
    if back.any():
        found = fit(parameters, model, found.values, found.used | back)
    return OutlierRejection(found, leave_one_out_distance(found), limit)


def leave_one_out_distance(fitted: Fit) -> Array:
    """How far each pose is from what the fit to the *other* poses predicts, (n,), squared, over its variance.

    For poses that were not used, from the fit itself.
    """
    J, r = fitted.at.jacobian, fitted.at.residual
    hat = np.einsum("nij,jk,nlk->nil", J, fitted.covariance, J, optimize=True)
    sign = np.where(fitted.used, -1.0, 1.0)[:, None, None]
    # a used pose pulls the fit towards itself, which shrinks the variance of its residual
    variance = np.eye(r.shape[1]) + sign * hat
    return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(variance, r[..., None])[..., 0]))


def _share_of_limit(fitted: Fit, false_alarm: float) -> tuple[Array, Array]:
    """How far each pose is as a share of its limit, and the limit; poses that tell less have a lower one."""
    components = np.maximum(fitted.at.is_informative.sum(axis=1), 1)
    distance = leave_one_out_distance(fitted)
    typical = float(np.median((distance / chi2.median(components))[fitted.used]))
    limit = chi2.isf(false_alarm, components) * max(1.0, typical)
    return distance / limit, limit
