"""Which motion would tell confusable hypotheses apart."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.prepared import Prepared


@dataclass(frozen=True, slots=True)
class Motion:
    """A candidate, and how well it would separate the pair that stays hardest to tell apart."""

    name: str
    separation: float
    """In sigmas of the floor, with all data before it."""
    now: float
    """The same without it."""


def next_motion(
    prepared: Prepared, sizes: Mapping[int, Array], candidates: Mapping[str, Prepared]
) -> tuple[Motion, ...]:
    """Candidates, best first, for hypotheses of estimated sizes, by index, in typical sizes.

    Of hypothesis g, sized x, the part that h cannot imitate by any size, nuisances free, has the square
    x'(R_gg - R_gh R_hh^-1 R_hg) x over the data so far and the candidate together. What counts is the least
    over pairs. A candidate is the prediction of a motion for the same hypotheses and nuisances, prepared.
    """
    now = _separation(_information([prepared]), prepared, sizes)
    found = [
        Motion(name, _separation(_information([prepared, motion]), prepared, sizes), now)
        for name, motion in candidates.items()
    ]
    return tuple(sorted(found, key=lambda motion: (-motion.separation, motion.name)))


def _information(parts: list[Prepared]) -> Array:
    """R per typical size of several campaigns together, nuisances free, (K, K)."""
    q, prior = parts[0].q, parts[0].prior / parts[0].nuisance_unit ** 2
    total = np.zeros((q + parts[0].owner.size,) * 2)
    for part in parts:
        by = np.concatenate([1.0 / part.nuisance_unit, part.scale])
        total += part.G.sum(axis=0) * np.outer(by, by)
    N = total[:q, :q] + np.diag(prior)
    return np.asarray(total[q:, q:] - total[q:, :q] @ np.linalg.solve(N, total[:q, q:]))


def _separation(R: Array, prepared: Prepared, sizes: Mapping[int, Array]) -> float:
    """The least over pairs, in sigmas."""
    least = np.inf
    for g, x in sizes.items():
        for h in sizes:
            if g != h:
                of_g, of_h = (np.flatnonzero(prepared.owner == one) for one in (g, h))
                across = R[np.ix_(of_g, of_h)]
                other = np.linalg.pinv(R[np.ix_(of_h, of_h)], hermitian=True)
                least = min(least, float(x @ (R[np.ix_(of_g, of_g)] - across @ other @ across.T) @ x))
    return float(np.sqrt(max(least, 0.0)))
