"""Compare two models by their losses on motions that took no part, in pairs."""

from collections.abc import Sequence

import numpy as np

from diagnosis.arrays import Array
from diagnosis.context import Context


def compare(context: Context, joints: Sequence[int], before: Array, after: Array) -> tuple[float, float]:
    """Compare the losses of left-out motions, in pairs.

    The standard error is that of differences or of logarithms of ratios, whichever says more. Motions of very
    different strength scatter in differences; motions that an effect does not touch scatter in ratios.

    Args:
        context: The context.
        joints: Joints to which the rows belong.
        before: Mean losses, (n_rows, n_motions), without a unit.
        after: Mean losses of another model, (n_rows, n_motions), without a unit.

    Returns:
        The mean improvement as a share of what can be explained, and over its standard error.
    """
    seen = ~np.isnan(before).all(axis=0)
    old, new = np.nanmean(before[:, seen], axis=0), np.nanmean(after[:, seen], axis=0)
    share = np.log(np.maximum(old, 1e-12)) - np.log(np.maximum(new, 1e-12))
    mean = float(np.mean(old - new))
    explainable = float(np.mean(old) - np.mean(context.noise_loss[list(joints)]))
    return mean / max(explainable, abs(mean), 1e-12), max(
        _mean_over_error(old - new), _mean_over_error(share)
    )


def _mean_over_error(values: Array) -> float:
    """Return the mean of values, (n,), over its standard error; 0 if there is none."""
    if len(values) < 2:
        return 0.0
    error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
    return float(np.mean(values)) / error if error > 0.0 else 0.0
