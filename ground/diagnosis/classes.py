"""Which hypotheses a campaign cannot tell apart: fixed before data."""

from typing import Final

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from fsw.kinematics.transforms import Array
from ground.diagnosis.layout import Ints
from ground.diagnosis.prepared import Prepared

ALIKE: Final = 0.99
"""|cos| of projected sensitivities above which two hypotheses are one to the campaign."""
DEGENERATE: Final = 1e-9


def alike(prepared: Prepared) -> Array:
    """|cos| of the largest principal angle between the columns of every two hypotheses, (H, H).

    In the metric R, with nuisances projected out. 0 between hypotheses of different numbers of columns (one
    is then a special case of the other at most: parsimony chooses), and of one that is not seen with any
    other.
    """
    of = [np.flatnonzero(prepared.owner == h) for h in range(len(prepared.hypotheses))]
    roots = [_inverse_root(prepared.R[-1][np.ix_(at, at)]) for at in of]
    whole = block_diag(*roots)
    cosines = whole.T @ prepared.R[-1] @ whole
    ranks = np.array([at.size for at in of])
    result = np.zeros((len(of), len(of)))
    for k in np.unique(ranks):
        chosen = np.flatnonzero(ranks == k)
        at = np.array([of[h] for h in chosen])
        pairs = cosines[at[:, None, :, None], at[None, :, None, :]]
        result[np.ix_(chosen, chosen)] = np.linalg.svd(pairs, compute_uv=False)[..., -1]
    result *= np.outer(prepared.seen, prepared.seen)
    np.fill_diagonal(result, 1.0)
    return result


def classes(prepared: Prepared, above: float = ALIKE) -> Ints:
    """The class of every hypothesis, (H,), numbered by first member: alike, or alike to one that is."""
    _, label = connected_components(csr_array(alike(prepared) > above), directed=False)
    _, first = np.unique(label, return_index=True)
    order = np.empty(first.size, np.intp)
    order[np.argsort(first)] = np.arange(first.size)
    return np.asarray(order[label])


def _inverse_root(R: Array) -> Array:
    """X with X'R X = 1 where R says anything, (k, k)."""
    s, V = np.linalg.eigh(R)
    told = s > DEGENERATE * max(s[-1], 1.0)
    return np.asarray(V * np.where(told, 1.0 / np.sqrt(np.where(told, s, 1.0)), 0.0))
