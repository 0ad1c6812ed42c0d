"""Hypotheses raced: which one, two or three explain a case, and predict blocks they were not fitted to."""

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
MIN_PREDICTED_SHARE: Final = 0.1
"""Share of what effects explain that blocks must be able to foretell of each other to have a say."""

Subset = tuple[int, ...]
"""Hypotheses, by index, in the order chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """Those that race: a campaign, the class of every hypothesis, and how surprising a finding must be."""

    equations: NormalEquations
    label: Ints
    """(H,)."""
    threshold: float
    """In -log10 of a probability (see `thresholds`)."""
    allowed: Flags
    """Hypotheses that may be chosen, (H,)."""

    def class_representative(self, one: int) -> int:
        """The first hypothesis of its class."""
        return int(np.flatnonzero(self.label == self.label[one])[0])


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Who won, and what else came near."""

    chosen: Subset
    ranking: tuple[int, ...]
    """The best as a single hypothesis, best first: also where none is accepted."""
    neg_log10_p: float
    """Of the best single hypothesis, -log10 of its probability if there is no effect."""
    t: Array
    """Sizes of the chosen in standard errors, as `Prepared.columns` orders them."""
    likelihood_ratio: float
    """Of the deviance, by all of the chosen."""
    shares: tuple[float, ...]
    """Of that, what is lost without each: the own shares; the rest is common to them."""


def select_effects(candidates: CandidateSet, rhs: RightHandSide) -> Selection:
    """Forward selection with exchange, to at most three effects, of which none may be left out.

    A hypothesis is added if it explains more than no-effect data do, unless with it held-out blocks are
    predicted worse by more than one standard error of the paired differences between blocks. They have a say
    only where they can foretell a share of it: not of what one block alone shows, nor of what is seen only
    because a nuisance would have to be beyond all that is known of it. Of hypotheses of one class only one
    may be chosen. A size at a bound is no finding.
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
    t = estimate_amplitudes(candidates.equations, rhs, columns)
    total = float(t @ rhs.all[columns])
    return Selection(chosen, first, best, t, total, _own_shares(candidates.equations, rhs, chosen, total))


def subset_neg_log10_p(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> float:
    """Of all of them together: parameters count."""
    columns = candidates.equations.columns(chosen)
    return float(neg_log10_p(likelihood_ratio(candidates.equations, rhs, columns), columns.size))


def best_addition(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> float:
    """Surprise of the most surprising hypothesis that could be added to those chosen."""
    return rank_additions(candidates, rhs, chosen)[1]


def _extend(
    candidates: CandidateSet, rhs: RightHandSide, chosen: Subset, loss: Array
) -> tuple[Subset, Array] | None:
    """One more, after exchange; None if nothing more is found, or if one of so many is not needed."""
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
    """Each of several in turn replaced by what explains more beside the others."""
    if len(chosen) == 1:
        return chosen
    for index in range(len(chosen)):
        others = (*chosen[:index], *chosen[index + 1 :])
        order, _ = rank_additions(candidates, rhs, others)
        if order:
            chosen = (*chosen[:index], order[0], *chosen[index + 1 :])
    return chosen


def _all_significant(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> bool:
    """Whether each one explains, beside the others, more than no-effect data do."""
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
    """Whether of what one more explains, blocks can foretell a share of each other."""
    few, many = equations.columns(shorter), equations.columns(longer)
    told = (
        cross_validated_gain(equations, rhs, many[None])[0]
        - cross_validated_gain(equations, rhs, few[None])[0]
    )
    return bool(
        told
        > MIN_PREDICTED_SHARE
        * (likelihood_ratio(equations, rhs, many) - likelihood_ratio(equations, rhs, few))
    )


def _clearly_worse(loss: Array) -> bool:
    """Whether a loss, by block, is more than a standard error of its sum above 0; one block tells nothing."""
    return loss.size > 1 and bool(loss.sum() > np.std(loss, ddof=1) * np.sqrt(loss.size))


def rank_additions(candidates: CandidateSet, rhs: RightHandSide, chosen: Subset) -> tuple[Subset, float]:
    """What may be added, best first, and the surprise of the most surprising among it.

    With a known floor, how unlikely an improvement is by chance tells more than a prediction of held-out
    blocks does, and counts parameters; effects that one block alone shows cannot be predicted at all.
    """
    equations, base = candidates.equations, candidates.equations.columns(chosen)
    beside = float(likelihood_ratio(equations, rhs, base)) if chosen else 0.0
    taken = np.isin(candidates.label, candidates.label[list(chosen)])
    who, surprises = [np.zeros(0, np.intp)], [np.zeros(0)]
    for k, hypotheses, columns in _candidate_columns(candidates, base, ~taken):
        t = estimate_amplitudes(equations, rhs, columns)
        gains = np.sum(t * rhs.all[columns], axis=-1) - beside
        ok = within_bounds(equations, t, columns) & (gains > 0.0)
        who.append(hypotheses[ok])
        surprises.append(neg_log10_p(gains[ok], k))
    index, high = np.concatenate(who), np.concatenate(surprises)
    order = np.argsort(-high, kind="stable")
    return tuple(int(h) for h in index[order]), float(high[order[0]]) if order.size else 0.0


def _candidate_columns(candidates: CandidateSet, base: Ints, free: Flags) -> list[tuple[int, Ints, Ints]]:
    """By number of columns k: hypotheses that may be added (n,), and their columns after the base (n, j)."""
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
    """(B,)."""
    return np.asarray(cross_validation_losses(equations, rhs, equations.columns(chosen)[None])[0])


def _own_shares(
    equations: NormalEquations, rhs: RightHandSide, chosen: Subset, total: float
) -> tuple[float, ...]:
    """What is lost without each, as a share of what all explain."""
    without = [
        float(likelihood_ratio(equations, rhs, equations.columns((*chosen[:i], *chosen[i + 1 :]))))
        if len(chosen) > 1
        else 0.0
        for i in range(len(chosen))
    ]
    return tuple((total - one) / total for one in without)
