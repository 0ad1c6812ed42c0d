"""Fits of sets of hypotheses to a case: how much they explain, and how much they predict."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.normal_equations import NormalEquations, RightHandSide
from ground.diagnosis.problem import Ints


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Nuisances and chosen columns, fitted together to all blocks."""

    active: Ints
    """Columns of `Prepared.A` that are in it: all nuisances, then the chosen, (n,)."""
    theta: Array
    """Their sizes, (n,)."""
    covariance: Array
    """(n, n)."""


def fit_linear(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> LinearFit:
    """The most probable nuisances and sizes; singular combinations stay at 0."""
    active = np.concatenate([np.arange(equations.q), equations.q + columns])
    information = equations.G[:, active[:, None], active].sum(axis=0)
    information[: equations.q, : equations.q] += np.diag(equations.prior)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    return LinearFit(active, covariance @ rhs.c[:, active].sum(axis=0), covariance)


def whitened_residual(equations: NormalEquations, fit: LinearFit, y: Array) -> Array:
    """Whitened residual after the model, (m,)."""
    return np.asarray(y - equations.A[:, fit.active] @ fit.theta)


FOLD_PRIOR_SHARE: Final = 0.01
"""In a fold, a size counts as learnt from data that say as much of it as this share of all data."""
ASYMPTOTIC_FROM: Final = 300.0
"""Half a drop beyond which probabilities are taken by their leading term."""
RIDGE_SHARE: Final = 1e-9
"""Share of the scale that is added, so that two columns that are the same can be solved."""


def estimate_amplitudes(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Most probable sizes in standard errors, (j,), of a set of columns; or (n, j) of n sets (n, j)."""
    R = equations.R[-1][columns[..., :, None], columns[..., None, :]] + RIDGE_SHARE * np.eye(
        columns.shape[-1]
    )
    return np.asarray(np.linalg.solve(R, rhs.all[columns][..., None])[..., 0])


def likelihood_ratio(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """By how much these columns make the deviance less than no effect, () or (n,)."""
    return np.asarray(np.sum(estimate_amplitudes(equations, rhs, columns) * rhs.all[columns], axis=-1))


def within_bounds(equations: NormalEquations, t: Array, columns: Ints) -> Flags:
    """Whether no size is at or beyond a bound, () or (n,)."""
    least, most = equations.bounds[:, columns]
    return np.asarray(np.all((t > least) & (t < most), axis=-1))


def cross_validation_losses(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Deviance of every block as predicted by the others, from that of no effect, (n, B) of n sets (n, j).

    The deviance of a block given the others is that of all blocks less that of the others, both with
    nuisances free: D(t) = t'R t - 2 r't. Normalising terms do not depend on the set.
    """
    r, t = rhs.r[:, columns], _fold_estimates(equations, rhs, columns)
    return np.asarray(
        _block_information(equations, columns, t) - 2.0 * np.einsum("fni,fni->nf", t, r[-1] - r[:-1])
    )


def cross_validated_gain(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """What sizes as other blocks have them would explain of each block, in sum, (n,): what losses can judge.

    What one block alone shows, or nothing but the prior of nuisances, no block foretells.
    """
    return np.asarray(
        _block_information(equations, columns, _fold_estimates(equations, rhs, columns)).sum(axis=-1)
    )


def _fold_estimates(equations: NormalEquations, rhs: RightHandSide, columns: Ints) -> Array:
    """Sizes as all blocks but one have them, (B, n, j).

    With LEARNT of the information of all blocks as a prior about 0, so that a fold that says nothing
    predicts nothing.
    """
    R = equations.R[:, columns[:, :, None], columns[:, None, :]]
    information = R[:-1] + FOLD_PRIOR_SHARE * R[-1] + RIDGE_SHARE * np.eye(columns.shape[1])
    return np.asarray(np.linalg.solve(information, rhs.r[:-1][:, columns][..., None])[..., 0])


def _block_information(equations: NormalEquations, columns: Ints, t: Array) -> Array:
    """What each block says of sizes (B, n, j) with the others known, t'R t, (n, B)."""
    R = equations.R[:, columns[:, :, None], columns[:, None, :]]
    return np.asarray(np.einsum("fni,fnij,fnj->nf", t, R[-1] - R[:-1], t))


def neg_log10_p(dropped: Array, k: Array | float) -> Array:
    """Of a drop with k more parameters: -log10 of its probability if there is nothing.

    Far out, where that is below the least floating-point number, by the leading term of the incomplete gamma
    function, so that even there the more surprising is told from the less.
    """
    x, half = np.maximum(dropped, 0.0) / 2.0, np.asarray(k) / 2.0
    far = x - (half - 1.0) * np.log(np.maximum(x, 1.0)) + gammaln(half)
    near = -chi2.logsf(2.0 * np.minimum(x, ASYMPTOTIC_FROM), k)
    return np.asarray(np.where(x > ASYMPTOTIC_FROM, far, near) / np.log(10.0))


def deviance_difference(neg_log10_p: float) -> float:
    """What a difference in surprise is as one in deviance, where probabilities are likelihoods."""
    return float(2.0 * np.log(10.0) * neg_log10_p)
