"""Linear fits of sets of columns to a case: amplitudes, likelihood ratio and cross-validation.

Every function solves R a = r of `normal_equations` for chosen columns. The likelihood-ratio statistic a'r is
the deviance that the columns explain. Without effect it follows a chi-square distribution with as many
degrees of freedom as there are columns (Wilks 1938). `columns` has shape (j,) for one set, (n, j) for n sets.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.normal_equations import NormalEquations, RightHandSide
from ground.diagnosis.problem import Ints

FOLD_PRIOR_SHARE: Final = 0.01
"""Precision of the prior about 0 in a fold, as a share of the information of all blocks."""
ASYMPTOTIC_FROM: Final = 300.0
"""Half a likelihood ratio above which the tail probability is computed by its leading term."""
RIDGE_SHARE: Final = 1e-9
"""Ridge added to R, so that two identical columns can be solved."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Nuisances and chosen columns, fitted together to all blocks."""

    active: Ints
    """Indices of the fitted columns of `NormalEquations.A`: all nuisances, then the chosen columns, shape
    (n,)."""
    theta: Array
    """Fitted values, shape (n,): nuisances in `nuisance_unit`, amplitudes in standard errors."""
    covariance: Array
    """Posterior covariance, shape (n, n)."""


def fit_linear(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> LinearFit:
    """Fit nuisances and chosen columns by maximum posterior; singular combinations stay at 0."""
    active = np.concatenate([np.arange(equations.q), equations.q + columns])
    information = equations.G[:, active[:, None], active].sum(axis=0)
    information[: equations.q, : equations.q] += np.diag(equations.prior)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    return LinearFit(active, covariance @ rhs.c[:, active].sum(axis=0), covariance)


def whitened_residual(equations: NormalEquations, fit: LinearFit, y: Array) -> Array:
    """Compute the residual of a fit.

    Args:
        equations: Normal equations of the campaign.
        fit: Linear fit to these features.
        y: Whitened features, shape (m,).

    Returns:
        Whitened residual, shape (m,).
    """
    return np.asarray(y - equations.A[:, fit.active] @ fit.theta)


def estimate_amplitudes(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Estimate the amplitudes of sets of columns, with nuisances free.

    Args:
        equations: Normal equations of the campaign.
        rhs: Right-hand side of the case.
        columns: Indices of columns, shape (j,) or (n, j).

    Returns:
        Amplitudes in standard errors, same shape as `columns`.
    """
    R = equations.R[-1][columns[..., :, None], columns[..., None, :]] + RIDGE_SHARE * np.eye(
        columns.shape[-1]
    )
    return np.asarray(np.linalg.solve(R, rhs.all[columns][..., None])[..., 0])


def likelihood_ratio(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Compute the deviance that columns explain, against no effect.

    Args:
        equations: Normal equations of the campaign.
        rhs: Right-hand side of the case.
        columns: Indices of columns, shape (j,) or (n, j).

    Returns:
        Likelihood-ratio statistic, shape () or (n,).
    """
    return np.asarray(np.sum(estimate_amplitudes(equations, rhs, columns) * rhs.all[columns], axis=-1))


def within_bounds(equations: NormalEquations, a: Array, columns: Ints) -> Flags:
    """Check that no amplitude is at or beyond a bound.

    Args:
        equations: Normal equations of the campaign.
        a: Amplitudes in units of standard errors, shape (j,) or (n, j).
        columns: Indices of columns, same shape.

    Returns:
        Flags, shape () or (n,).
    """
    least, most = equations.bounds[:, columns]
    return np.asarray(np.all((a > least) & (a < most), axis=-1))


def cross_validation_losses(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Compute the deviance of each block as predicted by the other blocks, relative to no effect.

    The deviance of a block given the others is that of all blocks minus that of the others. Both have free
    nuisances: D(a) = a'R a - 2 r'a. Normalising terms are the same for all sets.

    Args:
        equations: Normal equations of the campaign.
        rhs: Right-hand side of the case.
        columns: Indices of columns, shape (n, j).

    Returns:
        Losses, shape (n, b); negative where the prediction helps.
    """
    r, a = rhs.r[:, columns], _fold_estimates(equations, rhs, columns)
    return np.asarray(
        _block_information(equations, columns, a) - 2.0 * np.einsum("fni,fni->nf", a, r[-1] - r[:-1])
    )


def cross_validated_gain(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Compute the deviance of each block that amplitudes fitted to the other blocks would explain, summed.

    The gain is near 0 for an effect that only one block shows, or that only the nuisance prior reveals: then
    cross-validation cannot judge it.

    Args:
        equations: Normal equations of the campaign.
        rhs: Right-hand side of the case.
        columns: Indices of columns, shape (n, j).

    Returns:
        Gains, shape (n,).
    """
    return np.asarray(
        _block_information(equations, columns, _fold_estimates(equations, rhs, columns)).sum(axis=-1)
    )


def _fold_estimates(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Estimate amplitudes from all blocks but one, (b, n, j).

    The weak prior about 0 makes a fold without information predict nothing.
    """
    R = equations.R[:, columns[:, :, None], columns[:, None, :]]
    information = R[:-1] + FOLD_PRIOR_SHARE * R[-1] + RIDGE_SHARE * np.eye(columns.shape[1])
    return np.asarray(np.linalg.solve(information, rhs.r[:-1][:, columns][..., None])[..., 0])


def _block_information(equations: NormalEquations, columns: Ints, a: Array) -> Array:
    """Compute a'R a of each block given the others, for amplitudes a of shape (b, n, j); shape (n, b)."""
    R = equations.R[:, columns[:, :, None], columns[:, None, :]]
    return np.asarray(np.einsum("fni,fnij,fnj->nf", a, R[-1] - R[:-1], a))


def neg_log10_p(statistic: Array, k: Array | float) -> Array:
    """Convert likelihood ratios to -log10 of their probability without effect.

    Far in the tail the probability underflows. There the leading term of the incomplete gamma function is
    used, so that the order of strong findings is kept.

    Args:
        statistic: Likelihood-ratio statistics, unitless, shape () or (n,).
        k: Degrees of freedom, the number of extra parameters, unitless, shape () or (n,).

    Returns:
        -log10 of the chi-square tail probability, same shape.
    """
    x, half = np.maximum(statistic, 0.0) / 2.0, np.asarray(k) / 2.0
    far = x - (half - 1.0) * np.log(np.maximum(x, 1.0)) + gammaln(half)
    near = -chi2.logsf(2.0 * np.minimum(x, ASYMPTOTIC_FROM), k)
    return np.asarray(np.where(x > ASYMPTOTIC_FROM, far, near) / np.log(10.0))


def deviance_difference(neg_log10_p: float) -> float:
    """Convert a difference of -log10 p to a difference of deviance: probabilities count as likelihoods."""
    return float(2.0 * np.log(10.0) * neg_log10_p)
