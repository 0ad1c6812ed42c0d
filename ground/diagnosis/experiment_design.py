"""Which motion would tell confusable hypotheses apart."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.diagnose import Diagnosis
from ground.diagnosis.model import DiagnosisModel
from ground.diagnosis.normal_equations import NormalEquations, form_normal_equations


@dataclass(frozen=True, slots=True)
class CandidateMotion:
    """A candidate, and how well it would separate the pair that stays hardest to tell apart."""

    name: str
    separation: float
    """In sigmas of the floor, with all data before it."""
    now: float
    """The same without it."""


def rank_motions(
    equations: NormalEquations, sizes: Mapping[int, Array], candidates: Mapping[str, NormalEquations]
) -> tuple[CandidateMotion, ...]:
    """Candidates, best first, for hypotheses of estimated sizes, by index, in typical sizes.

    Of hypothesis g, sized x, the part that h cannot imitate by any size, nuisances free, has the square
    x'(R_gg - R_gh R_hh^-1 R_hg) x over the data so far and the candidate together. What counts is the least
    over pairs. A candidate is the prediction of a motion for the same hypotheses and nuisances, prepared.
    """
    now = _separation(_information([equations]), equations, sizes)
    found = [
        CandidateMotion(name, _separation(_information([equations, motion]), equations, sizes), now)
        for name, motion in candidates.items()
    ]
    return tuple(sorted(found, key=lambda motion: (-motion.separation, motion.name)))


def rank_repeats(model: DiagnosisModel, diagnosis: Diagnosis) -> tuple[CandidateMotion, ...]:
    """Motions of the campaign that are best done again, for what a diagnosis could not tell apart."""
    sizes: dict[int, Array] = {}
    for finding in diagnosis.findings:
        what = model.sensitivities.hypotheses[finding.hypothesis]
        rivals = (*finding.alternatives.hypotheses, *finding.confusable)
        if set(rivals) - {finding.hypothesis}:
            own = what.departures(finding.values)
            seen = float(np.linalg.norm(own * _scale(model, finding.hypothesis)))
            sizes |= {h: _equally_visible(model, h, seen) for h in rivals} | {finding.hypothesis: own}
    if len(sizes) < 2:
        return ()
    layout = model.sensitivities.layout
    blocks = {layout.blocks[b]: np.flatnonzero(layout.block == b) for b in np.unique(layout.block)}
    repeats = {name: form_normal_equations(model.sensitivities.select(rows)) for name, rows in blocks.items()}
    return rank_motions(model.equations, sizes, repeats)


def _scale(model: DiagnosisModel, hypothesis: int) -> Array:
    """Standard errors of a typical size, of each of its columns."""
    return np.asarray(model.equations.scale[model.equations.owner == hypothesis])


def _equally_visible(model: DiagnosisModel, hypothesis: int, seen: float) -> Array:
    """Sizes of another hypothesis that are so many standard errors, in typical ones."""
    scale = _scale(model, hypothesis)
    return np.asarray(seen / np.sqrt(scale.size) / np.where(scale > 0.0, scale, np.inf))


def _information(parts: list[NormalEquations]) -> Array:
    """R per typical size of several campaigns together, nuisances free, (K, K)."""
    q, prior = parts[0].q, parts[0].prior / parts[0].nuisance_unit ** 2
    total = np.zeros((q + parts[0].owner.size,) * 2)
    for part in parts:
        by = np.concatenate([1.0 / part.nuisance_unit, part.scale])
        total += part.G.sum(axis=0) * np.outer(by, by)
    N = total[:q, :q] + np.diag(prior)
    return np.asarray(total[q:, q:] - total[q:, :q] @ np.linalg.solve(N, total[:q, q:]))


def _separation(R: Array, equations: NormalEquations, sizes: Mapping[int, Array]) -> float:
    """The least over pairs, in sigmas."""
    least = np.inf
    for g, x in sizes.items():
        for h in sizes:
            if g != h:
                of_g, of_h = (np.flatnonzero(equations.owner == one) for one in (g, h))
                across = R[np.ix_(of_g, of_h)]
                other = np.linalg.pinv(R[np.ix_(of_h, of_h)], hermitian=True)
                least = min(least, float(x @ (R[np.ix_(of_g, of_g)] - across @ other @ across.T) @ x))
    return float(np.sqrt(max(least, 0.0)))
