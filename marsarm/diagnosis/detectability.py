"""Detectability before data: detection limits, aliased hypotheses and equivalence classes of a campaign."""

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
from marsarm.diagnosis.normal_equations import NormalEquations
from marsarm.diagnosis.problem import Ints
from simgap.selection.chance import FALSE_ALARM

ALIAS_COSINE: Final = 0.99
"""Absolute cosine of projected sensitivities above which two hypotheses cannot be distinguished."""
RANK_TOLERANCE: Final = 1e-9
"""Eigenvalues below this share of the greatest count as 0."""
KINDS_OF_TEST: Final = 2
"""Effects and the test of what remains share the probability of a false alarm."""
POWER: Final = 0.9
"""Probability that an effect at the detection limit passes the test."""


def alias_cosines(equations: NormalEquations) -> Array:
    """Compute the cosine of the largest principal angle between the columns of every two hypotheses.

    The metric is R, with nuisances eliminated. The cosine is 0 between hypotheses with different numbers of
    columns: one is at most a special case of the other, and parsimony decides. It is 0 for a hypothesis that
    is not identifiable.

    Args:
        equations: Normal equations of the campaign, with h hypotheses.

    Returns:
        Absolute cosines, shape (h, h).
    """
    of = [np.flatnonzero(equations.owner == h) for h in range(len(equations.hypotheses))]
    roots = [_inverse_root(equations.R[np.ix_(at, at)]) for at in of]
    whole = block_diag(*roots)
    cosines = whole.T @ equations.R @ whole
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


def equivalence_classes(equations: NormalEquations) -> Ints:
    """Return the equivalence class of every hypothesis, shape (h,), numbered by its first member.

    Classes are connected components: two members may have a smaller cosine than ALIAS_COSINE.
    """
    _, label = connected_components(csr_array(alias_cosines(equations) > ALIAS_COSINE), directed=False)
    _, first = np.unique(label, return_index=True)
    order = np.empty(first.size, np.intp)
    order[np.argsort(first)] = np.arange(first.size)
    return np.asarray(order[label])


def _inverse_root(R: Array) -> Array:
    """Return X (k, k) with X'R X = 1 on the range of R."""
    s, V = np.linalg.eigh(R)
    positive = s > RANK_TOLERANCE * max(s[-1], 1.0)
    return np.asarray(V * np.where(positive, 1.0 / np.sqrt(np.where(positive, s, 1.0)), 0.0))


@dataclass(frozen=True, slots=True)
class Detectability:
    """Detection limit of one hypothesis in a campaign."""

    limit: float
    """Detection limit in typical sizes, all amplitudes growing together; infinite if it is not
    identifiable."""
    family_wise_limit: float
    """Detection limit in the selection from all hypotheses, whose false alarms together have 5 %."""


@cache
def noncentrality(k: int, false_alarm: float = FALSE_ALARM) -> float:
    """Compute the noncentrality of a chi-square of k degrees of freedom for 90 % power and a false alarm."""
    beyond = chi2.isf(false_alarm, k)
    return float(brentq(lambda n: ncx2.sf(beyond, k, n) - POWER, 1e-6, 1e3))


def detection_limits(equations: NormalEquations, label: Ints) -> tuple[Detectability, ...]:
    """Compute the amplitude of every hypothesis that a likelihood-ratio test finds with 90 % power.

    The test against no effect has 5 % false alarm, with nuisances free. Its statistic is a noncentral
    chi-square of k degrees with noncentrality a'R a for amplitudes a. Typical sizes give a = limit * scale.
    In the selection from all hypotheses, each class has its share of half of that (Bonferroni); the test of
    what remains has the other half.

    Args:
        equations: Normal equations of the campaign, with h hypotheses.
        label: Equivalence class of every hypothesis, shape (h,).

    Returns:
        One a hypothesis.
    """
    result = []
    n_classes = np.unique(label[equations.identifiable]).size
    false_alarm_of_each = FALSE_ALARM / KINDS_OF_TEST / max(n_classes, 1)
    for index, seen in enumerate(equations.identifiable):
        at = np.flatnonzero(equations.owner == index)
        typical = equations.scale[at]
        information = float(typical @ equations.R[np.ix_(at, at)] @ typical)
        if not seen or information <= 0.0:
            result.append(Detectability(np.inf, np.inf))
            continue
        alone, family_wise = (
            float(np.sqrt(noncentrality(at.size, by) / information))
            for by in (FALSE_ALARM, false_alarm_of_each)
        )
        result.append(Detectability(alone, family_wise))
    return tuple(result)
