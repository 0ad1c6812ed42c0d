"""Experiment design: find the motion that would best distinguish aliases and alternatives."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.diagnose import Diagnosis
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.normal_equations import NormalEquations, form_normal_equations


@dataclass(frozen=True, slots=True)
class CandidateMotion:
    """Candidate motion, with the separation of the pair of hypotheses that is hardest to distinguish."""

    name: str
    separation: float
    """Separation in sigmas of the noise floor, with all data so far and this motion."""
    separation_now: float
    """Separation with all data so far."""


def rank_motions(
    equations: NormalEquations, sizes: Mapping[int, Array], candidates: Mapping[str, NormalEquations]
) -> tuple[CandidateMotion, ...]:
    """Rank candidate motions by the least separation over all pairs of hypotheses.

    The squared separation of hypothesis g, with amplitudes a in typical sizes, from hypothesis h is

        a'(R_gg - R_gh R_hh^-1 R_hg) a

    This is the part of g that h cannot imitate, with nuisances free. R sums the data so far and the
    candidate.

    Args:
        equations: Normal equations of the data so far.
        sizes: Amplitudes of each hypothesis, by index, in units of typical sizes, shape (n,).
        candidates: Normal equations of each candidate motion, for the same hypotheses and nuisances.

    Returns:
        Candidates, best first.
    """
    now = _separation(_information([equations]), equations, sizes)
    found = [
        CandidateMotion(name, _separation(_information([equations, motion]), equations, sizes), now)
        for name, motion in candidates.items()
    ]
    return tuple(sorted(found, key=lambda motion: (-motion.separation, motion.name)))


def rank_repeats(model: DiagnosisModel, diagnosis: Diagnosis) -> tuple[CandidateMotion, ...]:
    """Rank the campaign's motions by how well a repeat would distinguish aliases and alternatives."""
    sizes: dict[int, Array] = {}
    for finding in diagnosis.findings:
        hypothesis = model.sensitivities.hypotheses[finding.hypothesis]
        others = (one.hypothesis for one in finding.alternatives)
        alternatives = (*others, *finding.equivalence_class)
        if set(alternatives) - {finding.hypothesis}:
            own = hypothesis.departures(finding.values)
            seen = float(np.linalg.norm(own * _scale(model, finding.hypothesis)))
            sizes |= {h: _equally_visible(model, h, seen) for h in alternatives} | {finding.hypothesis: own}
    if len(sizes) < 2:
        return ()
    layout = model.sensitivities.layout
    blocks = {layout.blocks[b]: np.flatnonzero(layout.block == b) for b in np.unique(layout.block)}
    repeats = {name: form_normal_equations(model.sensitivities.select(rows)) for name, rows in blocks.items()}
    return rank_motions(model.equations, sizes, repeats)


def _scale(model: DiagnosisModel, hypothesis: int) -> Array:
    """Return the standard errors per typical size of each column of a hypothesis."""
    return np.asarray(model.equations.scale[model.equations.owner == hypothesis])


def _equally_visible(model: DiagnosisModel, hypothesis: int, seen: float) -> Array:
    """Return amplitudes in typical sizes with which a hypothesis is `seen` standard errors large."""
    scale = _scale(model, hypothesis)
    return np.asarray(seen / np.sqrt(scale.size) / np.where(scale > 0.0, scale, np.inf))


def _information(parts: list[NormalEquations]) -> Array:
    """Return the information per typical size of several campaigns together, nuisances eliminated, (k, k)."""
    q, prior = parts[0].q, parts[0].prior / parts[0].nuisance_unit ** 2
    total = np.zeros((q + parts[0].owner.size,) * 2)
    for part in parts:
        by = np.concatenate([1.0 / part.nuisance_unit, part.scale])
        total += part.G * np.outer(by, by)
    N = total[:q, :q] + np.diag(prior)
    return np.asarray(total[q:, q:] - total[q:, :q] @ np.linalg.solve(N, total[:q, q:]))


def _separation(R: Array, equations: NormalEquations, sizes: Mapping[int, Array]) -> float:
    """Return the least separation over all pairs, in sigmas."""
    least = np.inf
    for g, a in sizes.items():
        for h in sizes:
            if g != h:
                of_g, of_h = (np.flatnonzero(equations.owner == one) for one in (g, h))
                across = R[np.ix_(of_g, of_h)]
                other = np.linalg.pinv(R[np.ix_(of_h, of_h)], hermitian=True)
                least = min(least, float(a @ (R[np.ix_(of_g, of_g)] - across @ other @ across.T) @ a))
    return float(np.sqrt(max(least, 0.0)))
