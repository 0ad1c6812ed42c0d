"""Forward selection: find the one, two or three hypotheses that explain a case.

`select_effects` adds hypotheses to a set one by one, and exchanges those in it. The criterion is -log10 p of
the likelihood ratio (`linear_fit`). Cross-validation over blocks has a veto.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.linear_fit import (
    cross_validated_gain,
    cross_validation_losses,
    estimate_amplitudes,
    likelihood_ratio,
    neg_log10_p,
    within_bounds,
)
from ground.diagnosis.normal_equations import NormalEquations, RightHandSide
from ground.diagnosis.problem import Ints

MAX_EFFECTS: Final = 3
"""Largest number of effects in a diagnosis."""
MIN_PREDICTED_SHARE: Final = 0.1
"""Cross-validation has a veto only if blocks predict at least this share of the likelihood ratio in each
other."""

Subset = tuple[int, ...]
"""Hypotheses by index, in the order chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """Hypotheses that may be selected, with their normal equations and classes."""

    equations: NormalEquations
    label: Ints
    """Equivalence class of every hypothesis, shape (h,)."""
    threshold: float
    """Least -log10 p at which a hypothesis is selected (see `thresholds`)."""
    allowed: Flags
    """Flags of the hypotheses that may be chosen, shape (h,)."""

    def class_representative(self, one: int) -> int:
        """Return the first hypothesis of the same class."""
        return int(np.flatnonzero(self.label == self.label[one])[0])


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Selected hypotheses, and the ranking of single hypotheses."""

    chosen: Subset
    ranking: tuple[int, ...]
    """Single hypotheses that explain anything, best first, even if none is selected."""
    neg_log10_p: float
    """-log10 p of the best single hypothesis, without effect."""
    a: Array
    """Amplitudes of the chosen in standard errors, in the order of `NormalEquations.columns`."""
    likelihood_ratio: float
    """Deviance that all chosen together explain."""
    shares: tuple[float, ...]
    """Share of that deviance that is lost without each; the rest is common to several."""


def select_effects(candidates: CandidateSet, rhs: RightHandSide) -> Selection:
    """Select at most three effects by forward selection with exchange.

    A hypothesis is added if its -log10 p reaches the threshold. Cross-validation rejects it if the loss grows
    by more than one standard error of the paired differences between blocks. This veto applies only where
    blocks can predict each other. It does not apply to an effect that only one block shows, nor to one that
    only the nuisance prior reveals. A class contributes at most one hypothesis. An amplitude at a bound is
    not accepted.

    Args:
        candidates: Hypotheses that may be selected.
        rhs: Right-hand side of the case.

    Returns:
        Selection; `chosen` is empty if no hypothesis reaches the threshold.
    """
    chosen: Subset = ()
    loss = np.zeros(rhs.c.shape[0])
    first, best = rank_additions(candidates, rhs, ())
    while len(chosen) < MAX_EFFECTS:
        longer = _extend(candidates, rhs, chosen, loss)
        if longer is None:
            break
        chosen, loss = longer
    columns = candidates.equations.columns(chosen)
    a = estimate_amplitudes(candidates.equations, rhs, columns)
    total = float(a @ rhs.all[columns])
    return Selection(chosen, first, best, a, total, _own_shares(candidates.equations, rhs, chosen, total))


def subset_neg_log10_p(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> float:
    """Return -log10 p of all chosen hypotheses together, against no effect."""
    columns = candidates.equations.columns(chosen)
    return float(neg_log10_p(likelihood_ratio(candidates.equations, rhs, columns), columns.size))


def best_addition(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> float:
    """Return -log10 p of the most significant hypothesis that could be added."""
    return rank_additions(candidates, rhs, chosen)[1]


def _extend(
    candidates: CandidateSet, rhs: RightHandSide, chosen: Subset, loss: Array
) -> tuple[Subset, Array] | None:
    """Add one hypothesis, then exchange; return None if no addition is significant and predictive."""
    order, best = rank_additions(candidates, rhs, chosen)
    if not order or best < candidates.threshold:
        return None
    longer = _exchange(candidates, rhs, (*chosen, order[0]))
    after = _cross_validation_loss(candidates.equations, rhs, longer)
    vetoed = _clearly_worse(after - loss) and _is_predictable(candidates.equations, rhs, chosen, longer)
    if vetoed or not _all_significant(candidates, rhs, longer):
        return None
    return longer, after


def _exchange(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> Subset:
    """Replace each of several hypotheses in turn by the one that explains more beside the others."""
    if len(chosen) == 1:
        return chosen
    for index in range(len(chosen)):
        others = (*chosen[:index], *chosen[index + 1 :])
        order, _ = rank_additions(candidates, rhs, others)
        if order:
            chosen = (*chosen[:index], order[0], *chosen[index + 1 :])
    return chosen


def _all_significant(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> bool:
    """Check that each hypothesis reaches the threshold beside the others."""
    if len(chosen) == 1:
        return True
    equations, whole = (
        candidates.equations,
        float(likelihood_ratio(candidates.equations, rhs, candidates.equations.columns(chosen))),
    )
    for index, one in enumerate(chosen):
        others = equations.columns((*chosen[:index], *chosen[index + 1 :]))
        k = equations.columns((one,)).size
        if neg_log10_p(whole - likelihood_ratio(equations, rhs, others), k) < candidates.threshold:
            return False
    return True


def _is_predictable(equations: NormalEquations, rhs: RightHandSide, shorter: Subset, longer: Subset) -> bool:
    """Check that blocks predict in each other a share of what the extra hypothesis explains."""
    few, many = equations.columns(shorter), equations.columns(longer)
    gain = (
        cross_validated_gain(equations, rhs, many[None])[0]
        - cross_validated_gain(equations, rhs, few[None])[0]
    )
    return bool(
        gain
        > MIN_PREDICTED_SHARE
        * (likelihood_ratio(equations, rhs, many) - likelihood_ratio(equations, rhs, few))
    )


def _clearly_worse(loss: Array) -> bool:
    """Check that the summed loss exceeds 0 by more than one standard error; False for one block."""
    return loss.size > 1 and bool(loss.sum() > np.std(loss, ddof=1) * np.sqrt(loss.size))


def rank_additions(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> tuple[Subset, float]:
    """Rank the hypotheses that may be added, by -log10 p.

    With a known noise floor, -log10 p selects better than the prediction of held-out blocks. It counts
    parameters, and it also judges effects that only one block shows.

    Args:
        candidates: Hypotheses that may be selected.
        rhs: Right-hand side of the case.
        chosen: Hypotheses that are in the set already.

    Returns:
        Hypotheses, best first, and the greatest -log10 p of an addition; 0 if there is none.
    """
    equations, base = candidates.equations, candidates.equations.columns(chosen)
    beside = float(likelihood_ratio(equations, rhs, base)) if chosen else 0.0
    taken = np.isin(candidates.label, candidates.label[list(chosen)])
    indices, significances = [np.zeros(0, np.intp)], [np.zeros(0)]
    for k, hypotheses, columns in _candidate_columns(candidates, base, ~taken):
        a = estimate_amplitudes(equations, rhs, columns)
        gains = np.sum(a * rhs.all[columns], axis=-1) - beside
        ok = within_bounds(equations, a, columns) & (gains > 0.0)
        indices.append(hypotheses[ok])
        significances.append(neg_log10_p(gains[ok], k))
    index, significance = np.concatenate(indices), np.concatenate(significances)
    order = np.argsort(-significance, kind="stable")
    return tuple(int(h) for h in index[order]), float(significance[order[0]]) if order.size else 0.0


def _candidate_columns(candidates: CandidateSet, base: Ints, free: Flags) -> list[tuple[int, Ints, Ints]]:
    """Return, for each number of columns, the hypotheses (n,) that may be added, and all columns (n, j)."""
    equations = candidates.equations
    ranks = np.bincount(equations.owner, minlength=len(equations.hypotheses))
    starts = np.cumsum(ranks) - ranks
    result = []
    for k in np.unique(ranks):
        hypotheses = np.flatnonzero((ranks == k) & free & candidates.allowed)
        own = starts[hypotheses, None] + np.arange(k)
        columns = np.hstack([np.broadcast_to(base, (hypotheses.size, base.size)), own])
        result.append((int(k), hypotheses, columns))
    return result


def _cross_validation_loss(equations: NormalEquations, rhs: RightHandSide, chosen: Subset) -> Array:
    """Return the loss of each block, (b,)."""
    return np.asarray(cross_validation_losses(equations, rhs, equations.columns(chosen)[None])[0])


def _own_shares(
    equations: NormalEquations, rhs: RightHandSide, chosen: Subset, total: float
) -> tuple[float, ...]:
    """Return the share of the explained deviance that is lost without each hypothesis."""
    without = [
        float(likelihood_ratio(equations, rhs, equations.columns((*chosen[:i], *chosen[i + 1 :]))))
        if len(chosen) > 1
        else 0.0
        for i in range(len(chosen))
    ]
    return tuple((total - one) / total for one in without)
