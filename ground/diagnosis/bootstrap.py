"""Uncertainty of the selection: a wild bootstrap over blocks, and likelihoods of alternatives.

Blocks differ in their information (only one may touch the ground), so they are not resampled. Instead, the
residual of each block is multiplied by a random factor of mean 0 and variance 1, and added to the data (Wu
1986). The design is unchanged, and correlation within a block is kept. For the products of each block: c* = c
+ g (c - G theta).
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
"""A set of alternatives is the smallest that was chosen in this share of the draws."""
MIN_PROBABILITY: Final = 0.05
"""An alternative is dropped if its probability, alone against the chosen one, is below this."""


@dataclass(frozen=True, slots=True)
class Alternatives:
    """Hypotheses that may replace a chosen one, itself included."""

    hypotheses: Subset
    """One hypothesis of each class, most probable first."""
    probability: tuple[float, ...]
    """Probability of each, given that there is an effect."""

    def with_likelihoods(self, own: int, others: Mapping[int, float]) -> "Alternatives":
        """Add the alternatives that are likely, given how much more deviance each leaves.

        Args:
            own: Chosen hypothesis.
            others: Extra deviance of each other hypothesis in its place.

        Returns:
            Alternatives with the greater of bootstrap frequency and normalised likelihood, rescaled.
        """
        likelihoods = {one: float(np.exp(-max(worse, 0.0) / 2.0)) for one, worse in others.items()}
        likely = {
            one: likelihood
            for one, likelihood in likelihoods.items()
            if likelihood / (1.0 + likelihood) >= MIN_PROBABILITY
        }
        if not likely:
            return self
        likely[own] = 1.0
        whole = 1.0 + sum(likely.values())
        found = {one: p / whole for one, p in zip(self.hypotheses, self.probability, strict=True)}
        found |= {one: max(found.get(one, 0.0), likelihood / whole) for one, likelihood in likely.items()}
        likelihood = max(sum(self.probability), SET_COVERAGE) / sum(found.values())
        order = sorted(found, key=lambda one: -found[one])
        return Alternatives(tuple(order), tuple(found[one] * likelihood for one in order))


def bootstrap_selections(
    candidates: CandidateSet,
    rhs: RightHandSide,
    selection: Selection,
    seed: int,
    draws: int = BOOTSTRAP_DRAWS,
) -> tuple[Subset, ...]:
    """Repeat the selection on bootstrap draws.

    Args:
        candidates: Hypotheses that may be selected.
        rhs: Right-hand side of the case.
        selection: Selection on the data.
        seed: Seed of the draws.
        draws: Number of draws.

    Returns:
        Selected hypotheses of each draw.
    """
    equations, rng = candidates.equations, np.random.default_rng(seed)
    fit = fit_linear(equations, rhs, equations.columns(selection.chosen))
    residual = rhs.c - np.einsum("bij,j->bi", equations.G[:, :, fit.active], fit.theta)
    factors = rng.standard_normal((draws, rhs.c.shape[0], 1))
    return tuple(
        select_effects(candidates, reduce_block_sums(equations, rhs.c + factor * residual)).chosen
        for factor in factors
    )


def find_alternatives(
    candidates: CandidateSet, cosine: np.ndarray, selection: Selection, drawn: tuple[Subset, ...]
) -> tuple[Alternatives, ...]:
    """Count how often other classes replaced each chosen hypothesis.

    A chosen hypothesis is matched to a drawn one of its class, else to the remaining one with the greatest
    cosine. Draws with fewer effects are not counted.

    Args:
        candidates: Hypotheses that may be selected.
        cosine: Absolute cosines between h hypotheses, unitless, shape (h, h).
        selection: Selection on the data.
        drawn: Selected hypotheses of each draw.

    Returns:
        Smallest set of alternatives for each chosen hypothesis.
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
    """Return the best hypothesis of every other class in place of `one`, with its extra deviance.

    The deviance is derived from -log10 p, so that parameters count as in the selection.
    """
    others = tuple(other for other in chosen if other != one)
    best, found = subset_neg_log10_p(candidates, rhs, chosen), dict[int, float]()
    for other_choice in rank_additions(candidates, rhs, others)[0]:
        first = candidates.class_representative(other_choice)
        if candidates.label[other_choice] != candidates.label[one] and first not in found:
            found[first] = deviance_difference(
                best - subset_neg_log10_p(candidates, rhs, (*others, other_choice))
            )
    return found


def _match_classes(
    candidates: CandidateSet, cosine: np.ndarray, chosen: Subset, draw: Subset
) -> list[int | None]:
    """Match each chosen hypothesis to one of a draw; None if there is none left."""
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
    """Return the most frequent hypotheses that reach SET_COVERAGE; the chosen one if no draw counts."""
    total = sum(count.values())
    if not total:
        return Alternatives((own,), (0.0,))
    order = sorted(count, key=lambda one: (-count[one], one != own, one))
    reached = np.cumsum([count[one] for one in order]) / total
    upto = int(np.searchsorted(reached, SET_COVERAGE - 1e-12)) + 1
    return Alternatives(tuple(order[:upto]), tuple(count[one] / total for one in order[:upto]))
