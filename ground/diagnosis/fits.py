"""Fits of sets of hypotheses to a case: how much they explain, and how much they predict."""

from typing import Final

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.case import Case
from ground.diagnosis.layout import Ints
from ground.diagnosis.prepared import Prepared

LEARNT: Final = 0.01
"""In a fold, a size counts as learnt from data that say as much of it as this share of all data."""
FAR: Final = 300.0
"""Half a drop beyond which probabilities are taken by their leading term."""
RIDGE: Final = 1e-9
"""Share of the scale that is added, so that two columns that are the same can be solved."""


def sizes(prepared: Prepared, case: Case, columns: Ints) -> Array:
    """Most probable sizes in standard errors, (j,), of a set of columns; or (n, j) of n sets (n, j)."""
    R = prepared.R[-1][columns[..., :, None], columns[..., None, :]] + RIDGE * np.eye(columns.shape[-1])
    return np.asarray(np.linalg.solve(R, case.all[columns][..., None])[..., 0])


def drop(prepared: Prepared, case: Case, columns: Ints) -> Array:
    """By how much these columns make the deviance less than no effect, () or (n,)."""
    return np.asarray(np.sum(sizes(prepared, case, columns) * case.all[columns], axis=-1))


def within(prepared: Prepared, t: Array, columns: Ints) -> Flags:
    """Whether no size is at or beyond a bound, () or (n,)."""
    least, most = prepared.bounds[:, columns]
    return np.asarray(np.all((t > least) & (t < most), axis=-1))


def losses(prepared: Prepared, case: Case, columns: Ints) -> Array:
    """Deviance of every block as predicted by the others, from that of no effect, (n, B) of n sets (n, j).

    The deviance of a block given the others is that of all blocks less that of the others, both with
    nuisances free: D(t) = t'R t - 2 r't. Normalising terms do not depend on the set.
    """
    r, t = case.r[:, columns], _learnt(prepared, case, columns)
    return np.asarray(_of_blocks(prepared, columns, t) - 2.0 * np.einsum("fni,fni->nf", t, r[-1] - r[:-1]))


def foretold(prepared: Prepared, case: Case, columns: Ints) -> Array:
    """What sizes as other blocks have them would explain of each block, in sum, (n,): what losses can judge.

    What one block alone shows, or nothing but the prior of nuisances, no block foretells.
    """
    return np.asarray(_of_blocks(prepared, columns, _learnt(prepared, case, columns)).sum(axis=-1))


def _learnt(prepared: Prepared, case: Case, columns: Ints) -> Array:
    """Sizes as all blocks but one have them, (B, n, j).

    With LEARNT of the information of all blocks as a prior about 0, so that a fold that says nothing
    predicts nothing.
    """
    R = prepared.R[:, columns[:, :, None], columns[:, None, :]]
    information = R[:-1] + LEARNT * R[-1] + RIDGE * np.eye(columns.shape[1])
    return np.asarray(np.linalg.solve(information, case.r[:-1][:, columns][..., None])[..., 0])


def _of_blocks(prepared: Prepared, columns: Ints, t: Array) -> Array:
    """What each block says of sizes (B, n, j) with the others known, t'R t, (n, B)."""
    R = prepared.R[:, columns[:, :, None], columns[:, None, :]]
    return np.asarray(np.einsum("fni,fnij,fnj->nf", t, R[-1] - R[:-1], t))


def surprise(dropped: Array, k: Array | float) -> Array:
    """Of a drop with k more parameters: -log10 of its probability if there is nothing.

    Far out, where that is below the least floating-point number, by the leading term of the incomplete gamma
    function, so that even there the more surprising is told from the less.
    """
    x, half = np.maximum(dropped, 0.0) / 2.0, np.asarray(k) / 2.0
    far = x - (half - 1.0) * np.log(np.maximum(x, 1.0)) + gammaln(half)
    near = -chi2.logsf(2.0 * np.minimum(x, FAR), k)
    return np.asarray(np.where(x > FAR, far, near) / np.log(10.0))


def deviance_of(surprise: float) -> float:
    """What a difference in surprise is as one in deviance, where probabilities are likelihoods."""
    return float(2.0 * np.log(10.0) * surprise)
