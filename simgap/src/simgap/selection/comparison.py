"""Compare two models by the residuals of motions that took no part, in pairs."""

import numpy as np

from simgap.arrays import Array, Integers
from simgap.residuals.blocks import cut_rows
from simgap.residuals.loss import half_loss_derivatives, pseudo_huber
from simgap.selection.context import Context


def improvement_share(context: Context, rows: Integers, before: Array, after: Array) -> float:
    """Return the mean improvement of the losses of left-out motions, as a share of what can be explained.

    Args:
        rows: Rows of the residual model, (n_rows,) indices.
        before: Their residuals when their motion was left out, over their scales, (n_rows,), without a unit.
        after: The same of another model, (n_rows,), without a unit.

    Returns:
        The share, from -1 to 1.
    """
    loss = pseudo_huber(before)
    mean = float(np.mean(loss - pseudo_huber(after)))
    explainable = float(np.mean(loss - context.noise_loss[context.model.joint_of[rows]]))
    return mean / max(explainable, abs(mean), 1e-12)


def improvement_z(context: Context, rows: Integers, before: Array, after: Array) -> float:
    """Return the improvement of the losses of left-out motions, over its standard error.

    Where repeats show the noise, the standard error is what that noise can do: an effect counts although it
    acts in few motions, such as a limit. Else it is the scatter from motion to motion, which counts a misfit.

    Args:
        rows: Rows of the residual model, (n_rows,) indices.
        before: Their residuals when their motion was left out, over their scales, (n_rows,), without a unit.
        after: The same of another model, (n_rows,), without a unit.

    Returns:
        The ratio.
    """
    if knows_noise(context, rows):
        return compare_with_noise(context, rows, before, after)
    return compare_motions(context.model.motion_of[rows], pseudo_huber(before), pseudo_huber(after))


def knows_noise(context: Context, rows: Integers) -> bool:
    """Return whether the noise of all joints is known, or shown by repeated motions.

    Args:
        rows: Rows of the joints in the residual model, (n_rows,) indices.

    Returns:
        True if they do.
    """
    return bool(context.model.noise_std) or bool(
        np.all(context.noise_loss[np.unique(context.model.joint_of[rows])] > 0.0)
    )


def compare_motions(motion: Integers, before: Array, after: Array) -> float:
    """Return the improvement of the losses of motions, over its scatter between them.

    The improvement is that of differences or of logarithms of ratios, whichever says more. Motions of very
    different strength scatter in differences; motions that an effect does not touch scatter in ratios.

    Args:
        motion: Motion of each loss, (n_rows,), index.
        before: Losses, (n_rows,), without a unit.
        after: Losses of another model, (n_rows,), without a unit.

    Returns:
        The mean over its standard error; 0 with fewer than two motions.
    """
    _, motion = np.unique(motion, return_inverse=True)
    count = np.bincount(motion)
    old, new = np.bincount(motion, weights=before) / count, np.bincount(motion, weights=after) / count
    ratios = np.log(np.maximum(old, 1e-12) / np.maximum(new, 1e-12))
    return max(_mean_over_error(old - new), _mean_over_error(ratios))


def _mean_over_error(values: Array) -> float:
    """Return the mean of values, (n,), over its standard error; 0 if there is none."""
    if len(values) < 2:
        return 0.0
    error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
    return float(np.mean(values)) / error if error > 0.0 else 0.0


def compare_with_noise(context: Context, rows: Integers, before: Array, after: Array) -> float:
    """Return the mean improvement of a loss over the standard error by the noise that remains.

    Where two models differ, noise makes one of them the better by chance: to first order, by the slope of
    the loss times the difference. Its totals over blocks of the noise are independent.

    Args:
        rows: Rows of the residual model, (n_rows,) indices.
        before: Their residuals over their scales, (n_rows,), without a unit.
        after: The same of another model, (n_rows,), without a unit.

    Returns:
        The ratio; 0 where the models do not differ.
    """
    slope, _ = half_loss_derivatives(after)
    totals = np.bincount(cut_rows(context.model, rows, after), weights=2.0 * slope * (before - after))
    error = float(np.sqrt(totals @ totals))
    return float(np.sum(pseudo_huber(before) - pseudo_huber(after))) / error if error > 0.0 else 0.0
