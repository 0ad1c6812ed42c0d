"""Squared distances of poses from what the others predict, and what counts as an outlier."""

from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.serial_arm.fit import Fit

FALSE_ALARM: Final = 0.01
"""Probability of reporting an outlier in a campaign without outliers."""
MAX_OUTLIER_SHARE: Final = 0.2
"""Largest share of poses that may be outliers; if there are more, the model is wrong."""


def leave_one_out_distance(fitted: Fit) -> Array:
    """Compute the squared distance of each pose from the prediction of a fit to the other poses.

    For poses that were not fitted, the fit itself predicts.

    Args:
        fitted: Fit with its linearisation.

    Returns:
        Squared distances over their variances, unitless, shape (n,).
    """
    J, r = fitted.at.jacobian, fitted.at.residual
    hat = np.einsum("nij,jk,nlk->nil", J, fitted.covariance, J, optimize=True)
    sign = np.where(fitted.used, -1.0, 1.0)[:, None, None]
    # a fitted pose pulls the fit towards itself, which reduces the variance of its residual
    variance = np.eye(r.shape[1]) + sign * hat
    return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(variance, r[..., None])[..., 0]))
