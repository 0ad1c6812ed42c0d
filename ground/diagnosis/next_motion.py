"""Which motion would tell confusable hypotheses apart."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.diagnose import Diagnosis
from ground.diagnosis.prepared import Prepared, prepare
from ground.diagnosis.ready import Ready


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


def again(ready: Ready, told: Diagnosis) -> tuple[Motion, ...]:
    """Motions of the campaign that are best done again, for what a diagnosis could not tell apart."""
    sizes: dict[int, Array] = {}
    for finding in told.findings:
        what = ready.found.hypotheses[finding.hypothesis]
        rivals = (*finding.alternatives.hypotheses, *finding.confusable)
        if set(rivals) - {finding.hypothesis}:
            own = what.departures(finding.values)
            seen = float(np.linalg.norm(own * _scale(ready, finding.hypothesis)))
            sizes |= {h: _as_much(ready, h, seen) for h in rivals} | {finding.hypothesis: own}
    if len(sizes) < 2:
        return ()
    layout = ready.found.layout
    blocks = {layout.blocks[b]: np.flatnonzero(layout.block == b) for b in np.unique(layout.block)}
    repeats = {name: prepare(ready.found.of(rows)) for name, rows in blocks.items()}
    return next_motion(ready.prepared, sizes, repeats)


def _scale(ready: Ready, hypothesis: int) -> Array:
    """Standard errors of a typical size, of each of its columns."""
    return np.asarray(ready.prepared.scale[ready.prepared.owner == hypothesis])


def _as_much(ready: Ready, hypothesis: int, seen: float) -> Array:
    """Sizes of another hypothesis that are so many standard errors, in typical ones."""
    scale = _scale(ready, hypothesis)
    return np.asarray(seen / np.sqrt(scale.size) / np.where(scale > 0.0, scale, np.inf))


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
