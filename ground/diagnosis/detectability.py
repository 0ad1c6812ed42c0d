"""How large an effect must be to be seen in a campaign: known before data."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2, ncx2

from fsw.kinematics.transforms import Array
from ground.diagnosis.normal_equations import ABSORBED_SHARE, NormalEquations
from ground.diagnosis.problem import Ints

ALIAS_COSINE: Final = 0.99
"""|cos| of projected sensitivities above which two hypotheses are one to the campaign."""
RANK_TOLERANCE: Final = 1e-9


def alias_cosines(equations: NormalEquations) -> Array:
    """|cos| of the largest principal angle between the columns of every two hypotheses, (H, H).

    In the metric R, with nuisances projected out. 0 between hypotheses of different numbers of columns (one
    is then a special case of the other at most: parsimony chooses), and of one that is not seen with any
    other.
    """
    of = [np.flatnonzero(equations.owner == h) for h in range(len(equations.hypotheses))]
    roots = [_inverse_root(equations.R[-1][np.ix_(at, at)]) for at in of]
    whole = block_diag(*roots)
    cosines = whole.T @ equations.R[-1] @ whole
    ranks = np.array([at.size for at in of])
    result = np.zeros((len(of), len(of)))
    for k in np.unique(ranks):
        chosen = np.flatnonzero(ranks == k)
        at = np.array([of[h] for h in chosen])
        pairs = cosines[at[:, None, :, None], at[None, :, None, :]]
        result[np.ix_(chosen, chosen)] = np.linalg.svd(pairs, compute_uv=False)[..., -1]
    result *= np.outer(equations.identifiable, equations.identifiable)
    np.fill_diagonal(result, 1.0)
    return result


def equivalence_classes(equations: NormalEquations, above: float = ALIAS_COSINE) -> Ints:
    """The class of every hypothesis, (H,), numbered by first member: alike, or alike to one that is."""
    _, label = connected_components(csr_array(alias_cosines(equations) > above), directed=False)
    _, first = np.unique(label, return_index=True)
    order = np.empty(first.size, np.intp)
    order[np.argsort(first)] = np.arange(first.size)
    return np.asarray(order[label])


def _inverse_root(R: Array) -> Array:
    """X with X'R X = 1 where R says anything, (k, k)."""
    s, V = np.linalg.eigh(R)
    told = s > RANK_TOLERANCE * max(s[-1], 1.0)
    return np.asarray(V * np.where(told, 1.0 / np.sqrt(np.where(told, s, 1.0)), 0.0))


TEST_FALSE_ALARM: Final = 0.05
POWER: Final = 0.9


@dataclass(frozen=True, slots=True)
class Detectability:
    """What a campaign can see of one hypothesis."""

    limit: float
    """In typical sizes, all size parameters growing together; infinite if it is not seen."""
    blocks: float
    """In how many blocks, effectively, it is seen: below 2 it cannot be cross-validated."""


@cache
def noncentrality(k: int, power: float = POWER, false_alarm: float = TEST_FALSE_ALARM) -> float:
    """Of a chi-square of k degrees, so that a test of this false alarm has this power."""
    beyond = chi2.isf(false_alarm, k)
    return float(brentq(lambda n: ncx2.sf(beyond, k, n) - power, 1e-6, 1e3))


def detection_limits(equations: NormalEquations) -> tuple[Detectability, ...]:
    """Of every hypothesis: the size that a likelihood-ratio test against no effect finds with 90 % power.

    At 5 % false alarm, nuisances free. Its statistic is a noncentral chi-square of k degrees with
    noncentrality d'R d for sizes d; typical sizes make d = limit * scale. Blocks seen is the inverse of the
    sum of squared shares of the information that is lost when a block is left out.
    """
    result = []
    lost = equations.R[-1] - equations.R[:-1]
    for index, seen in enumerate(equations.identifiable):
        at = np.flatnonzero(equations.owner == index)
        typical = equations.scale[at]
        information = float(typical @ equations.R[-1][np.ix_(at, at)] @ typical)
        if not seen or information <= 0.0:
            result.append(Detectability(np.inf, 0.0))
            continue
        share = np.maximum(np.einsum("i,bij,j->b", typical, lost[:, at[:, None], at], typical), 0.0)
        blocks = float(share.sum() ** 2 / np.sum(share**2))
        result.append(Detectability(float(np.sqrt(noncentrality(at.size) / information)), blocks))
    return tuple(result)


def column_detection_limit(equations: NormalEquations, columns: Array) -> float:
    """The same limit of what is no hypothesis: its change of the features (m, k) per typical size."""
    S, N = equations.whiten(columns), equations.A[:, : equations.q]
    whole = S.sum(axis=1)
    along = N.T @ whole
    before = float(whole @ whole)
    information = before - float(along @ equations.C[-1] @ along)
    if information <= ABSORBED_SHARE * before:
        return np.inf
    return float(np.sqrt(noncentrality(columns.shape[1]) / information))
