"""Judge fits by motions that they leave out."""

from collections.abc import Sequence

import numpy as np

from simgap.arrays import Array
from simgap.residuals.loss import half_loss_derivatives
from simgap.selection.context import Context, simulate
from simgap.selection.fit import STEP, Fit


def cross_validate(context: Context, fits: Sequence[Fit]) -> Array:
    """Predict the residuals of each motion by a fit without its fold.

    Args:
        fits: Fits of different joints.

    Returns:
        Each residual when its motion was left out, over the scale of its joint, (n_rows,); 0 without a fit.
    """
    found = np.zeros(context.model.joint_of.size)
    for fit, left_out in zip(fits, cross_validate_each(context, fits), strict=True):
        found[fit.rows] = left_out
    return found


def cross_validate_each(context: Context, fits: Sequence[Fit]) -> list[Array]:
    """Predict the residuals of each motion without its fold, for each fit by itself.

    Where the noise is known, nothing is left out: the chance of an effect counts what its sizes explain of
    the noise.

    A fit without a fold begins at the optimum of all motions and takes one Newton step, with the
    Jacobian of that optimum. It is then simulated, so that nothing of its loss is linearised.

    Returns:
        The residuals of each fit when their motion was left out, over the scale of their joint, (n_rows,).
    """
    joint_of = context.model.joint_of
    if context.model.noise_std:
        return [fit.residuals / context.scales[joint_of[fit.rows]] for fit in fits]
    points = []
    for fit in fits:
        sizes = np.tile(fit.sizes, (len(context.model.motions), 1))
        for fold in context.folds:
            sizes[sorted(fold)] = step_without(context, fit, fold)
        points.append((fit.joint, sizes))
    rows = simulate(context, points, "cross-validation")
    return [row / context.scales[joint_of[fit.rows]] for fit, row in zip(fits, rows, strict=True)]


def step_without(context: Context, fit: Fit, fold: frozenset[int]) -> Array:
    """Return the sizes of a fit after one step without a fold of motions.

    A size at a bound stays there if the step would lead beyond it. Derivatives are known to about STEP: what
    changes in sizes together do to the residual is not known where it is STEP times less than what they do
    alone, and the step does not go there.

    Args:
        fit: Fit of all motions.
        fold: Indices of motions that take no part.

    Returns:
        (n_sizes,), in their own units.
    """
    model, free = context.model, fit.columns
    sizes = context.union.sizes_at(free)
    low, high = np.array([size.low for size in sizes]), np.array([size.high for size in sizes])
    prior = np.array([size.prior_std for size in sizes]) ** -2.0
    weight = np.where(np.isin(model.motion_of[fit.rows], sorted(fold)), 0.0, 1.0)
    weight /= context.scales[model.joint_of[fit.rows]]
    a, at = fit.jacobian * weight[:, None], fit.sizes[free]
    slope, curvature = half_loss_derivatives(fit.residuals * weight)
    gradient = a.T @ slope + prior * at
    go = ~(((at <= low) & (gradient > 0.0)) | ((at >= high) & (gradient < 0.0)))
    normal = (a.T @ (a * curvature[:, None]) + np.diag(prior))[np.ix_(go, go)]
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(unit, unit), rcond=STEP**2, hermitian=True)
    at[go] -= inverse @ (gradient[go] / unit) / unit
    found = fit.sizes.copy()
    found[free] = np.clip(at, low, high)
    return found
