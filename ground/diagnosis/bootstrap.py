"""How sure a choice is: the selection repeated on data that might as well have been seen, and likelihoods.

Blocks differ in what they can tell (only one of them may touch the ground), so they are not left out or
doubled. What the best model leaves of each block is added to the data again with a random factor of mean 0
and variance 1: the design stays as it is, and what is dependent within a block stays so. In sums over
blocks, c* = c + g (c - G theta).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground.diagnosis.linear_fit import deviance_difference, fit_linear
from ground.diagnosis.normal_equations import RightHandSide, reduce_block_sums
from ground.diagnosis.selection import (
    CandidateSet,
    Selection,
    Subset,
    rank_additions,
    select_effects,
    subset_neg_log10_p,
)

BOOTSTRAP_DRAWS: Final = 200
SET_COVERAGE: Final = 0.95
"""A set of alternatives is the fewest that were chosen in this share of the draws."""
MIN_PROBABILITY: Final = 0.05
"""What is less probable than that, alone against what was chosen, does not stand in its stead."""


@dataclass(frozen=True, slots=True)
class Alternatives:
    """What may stand where a chosen hypothesis stands."""

    hypotheses: Subset
    """One of each class, most probable first: chosen in SURE of the draws in which any was, or likely."""
    probability: tuple[float, ...]
    """Which it is, given that there is an effect. Whether there is, surprise tells."""

    def with_likelihoods(self, own: int, others: Mapping[int, float]) -> "Alternatives":
        """With others that are worse than the chosen one by so much deviance, as far as they are likely."""
        odds = {one: float(np.exp(-max(worse, 0.0) / 2.0)) for one, worse in others.items()}
        likely = {one: by for one, by in odds.items() if by / (1.0 + by) >= MIN_PROBABILITY}
        if not likely:
            return self
        likely[own] = 1.0
        whole = 1.0 + sum(likely.values())
        found = {one: p / whole for one, p in zip(self.hypotheses, self.probability, strict=True)}
        found |= {one: max(found.get(one, 0.0), by / whole) for one, by in likely.items()}
        by = max(sum(self.probability), SET_COVERAGE) / sum(found.values())
        order = sorted(found, key=lambda one: -found[one])
        return Alternatives(tuple(order), tuple(found[one] * by for one in order))


def bootstrap_selections(
    candidates: CandidateSet,
    rhs: RightHandSide,
    selection: Selection,
    seed: int,
    draws: int = BOOTSTRAP_DRAWS,
) -> tuple[Subset, ...]:
    """What is chosen in every draw."""
    equations, rng = candidates.equations, np.random.default_rng(seed)
    fit = fit_linear(equations, rhs, equations.columns(selection.chosen))
    left = rhs.c - np.einsum("bij,j->bi", equations.G[:, :, fit.active], fit.theta)
    factors = rng.standard_normal((draws, rhs.c.shape[0], 1))
    return tuple(
        select_effects(candidates, reduce_block_sums(equations, rhs.c + factor * left)).chosen
        for factor in factors
    )


def find_alternatives(
    candidates: CandidateSet, cosine: np.ndarray, selection: Selection, drawn: tuple[Subset, ...]
) -> tuple[Alternatives, ...]:
    """For each chosen hypothesis: what was chosen in its stead, and how often.

    In a draw, a chosen hypothesis stands for itself if its class is there; otherwise the one most like it
    stands for it that stands for no other. Draws with fewer effects say nothing of it.
    """
    counts: list[dict[int, int]] = [{} for _ in selection.chosen]
    for draw in drawn:
        for count, stands in zip(
            counts, _match_classes(candidates, cosine, selection.chosen, draw), strict=True
        ):
            if stands is not None:
                count[stands] = count.get(stands, 0) + 1
    return tuple(_smallest_set(count, own) for count, own in zip(counts, selection.chosen, strict=True))


def replacement_deviances(
    candidates: CandidateSet, rhs: RightHandSide, chosen: Subset, one: int
) -> dict[int, float]:
    """The best of every other class in the place of one of the chosen, and by how much it is the worse.

    In deviance; more parameters count as in the race, by what they explain by chance.
    """
    others = tuple(other for other in chosen if other != one)
    best, found = subset_neg_log10_p(candidates, rhs, chosen), dict[int, float]()
    for rival in rank_additions(candidates, rhs, others)[0]:
        first = candidates.class_representative(rival)
        if candidates.label[rival] != candidates.label[one] and first not in found:
            found[first] = deviance_difference(best - subset_neg_log10_p(candidates, rhs, (*others, rival)))
    return found


def _match_classes(
    candidates: CandidateSet, cosine: np.ndarray, chosen: Subset, draw: Subset
) -> list[int | None]:
    """Which of the draw stands for which of the chosen; of its own class, the chosen itself."""
    free = list(draw)
    stands: list[int | None] = [None] * len(chosen)
    for index, one in enumerate(chosen):
        same = [other for other in free if candidates.label[other] == candidates.label[one]]
        if same:
            free.remove(same[0])
            stands[index] = one
    for index, one in enumerate(chosen):
        if stands[index] is None and free:
            best = max(free, key=cosine[one].__getitem__)
            free.remove(best)
            stands[index] = candidates.class_representative(best)
    return stands


def _smallest_set(count: dict[int, int], own: int) -> Alternatives:
    """The fewest that make up SURE of the draws; the chosen one alone if no draw has it or another."""
    total = sum(count.values())
    if not total:
        return Alternatives((own,), (0.0,))
    order = sorted(count, key=lambda one: (-count[one], one != own, one))
    reached = np.cumsum([count[one] for one in order]) / total
    upto = int(np.searchsorted(reached, SET_COVERAGE - 1e-12)) + 1
    return Alternatives(tuple(order[:upto]), tuple(count[one] / total for one in order[:upto]))
