"""Rejection of outliers: poses that do not agree with the others are left out one by one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from simgap.common.errors import BadRequest
from simgap.serial_arm.fit import (
    FALSE_ALARM,
    MAX_OUTLIER_SHARE,
    Fit,
    FitParameter,
    ResidualModel,
    fit,
    leave_one_out_distance,
)


class TooManyOutliers(BadRequest):
    """Error: more poses are outliers than are allowed."""


@dataclass(frozen=True, slots=True, eq=False)
class OutlierRejection:
    """Fit without its outliers."""

    fit: Fit
    distance: Array
    """Squared distance of each pose from the prediction by the others, over its variance, shape (n,)."""
    limit: Array
    """Limit of this distance, shape (n,)."""

    @property
    def outliers(self) -> tuple[int, ...]:
        """Return the indices of the poses that were left out."""
        return tuple(int(pose) for pose in np.flatnonzero(~self.fit.used))


def reject_outliers(
    parameters: Sequence[FitParameter],
    model: ResidualModel,
    start: Array | None = None,
    used: Flags | None = None,
    false_alarm: float = FALSE_ALARM,
) -> OutlierRejection:
    """Fit, leave out the worst pose beyond the limit, and repeat until all remaining poses agree.

    Poses that agree with the last fit are included again. If all poses have more noise than stated, the
    limit rises, so that no outliers appear.

    Args:
        parameters: Parameters with scales and priors.
        start: Initial values in the units of the parameters, shape (p,); zeros by default.
        used: Boolean flags of the poses to fit, shape (n,); all by default.
        false_alarm: Probability of reporting an outlier if there is none.

    Returns:
        The fit without its outliers.

    Raises:
        TooManyOutliers: Too many poses would be left out.
    """
    found = fit(parameters, model, start, used)
    selected = found.used
    count = int(np.count_nonzero(selected))
    while True:
        share, limit = _share_of_limit(found, false_alarm / count)
        worst = int(np.argmax(np.where(found.used, share, -np.inf)))
        if share[worst] <= 1.0:
            break
        keep = found.used & (np.arange(share.size) != worst)
        if np.count_nonzero(selected & ~keep) > MAX_OUTLIER_SHARE * count:
            raise TooManyOutliers(
                f"more than {MAX_OUTLIER_SHARE:.0%} of {count} poses do not agree with the rest: no arm "
                "explains them all"
            )
        found = fit(parameters, model, found.values, keep)
    restored = selected & ~found.used & (share <= 1.0)
    if restored.any():
        found = fit(parameters, model, found.values, found.used | restored)
    return OutlierRejection(found, leave_one_out_distance(found), limit)


def _share_of_limit(fitted: Fit, false_alarm: float) -> tuple[Array, Array]:
    """Compute the distance of each pose as a share of its limit, and the limit.

    Poses with fewer informative components have a lower limit.
    """
    components = np.maximum(fitted.at.is_informative.sum(axis=1), 1)
    distance = leave_one_out_distance(fitted)
    typical = float(np.median((distance / chi2.median(components))[fitted.used]))
    limit = chi2.isf(false_alarm, components) * max(1.0, typical)
    return distance / limit, limit
