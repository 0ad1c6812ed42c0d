"""Closure of a diagnosis on held-out motion, and the motion to record next.

It is the share of the explainable residual that the findings remove on held-out motion.

Held-out motion takes no part in fitting or selection. The explainable residual lies in the directions in
which detectable effects move that motion, and in the direction of the findings. The energy of noise in those
directions is subtracted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.diagnose import Diagnosis
from marsarm.diagnosis.model import DiagnosisModel, noncentrality
from marsarm.diagnosis.normal_equations import (
    NormalEquations,
    Whitener,
    build_whitener,
    form_normal_equations,
)
from marsarm.diagnosis.problem import INTERVAL_QUANTILES, FeatureLayout
from marsarm.diagnosis.sensitivity import Sensitivities

NOISE_DRAWS: Final = 2000
"""Number of noise draws for the interval."""
MIN_GAP_SIGMAS: Final = 2.0
"""Sigmas of noise above which the explainable energy must lie, else no share is given."""
MIN_MOVED_SIGMAS: Final = 2.0
"""Sigmas by which effects at their detection limit must move the features along an explainable direction."""
MAX_LEVERAGE: Final = 0.5
"""Leverage above which a feature does not estimate its own noise; the noise floor is used."""


@dataclass(frozen=True, slots=True)
class ChannelClosure:
    """Root mean squares of one channel on held-out motion, in its unit."""

    channel: str
    unit: str
    before: float
    after: float
    noise_floor: float


@dataclass(frozen=True, slots=True)
class Closure:
    """Share of the explainable residual that is removed; NaN, with an infinite interval, if too little."""

    share: float
    least: float
    most: float
    """Upper end of the 90 % interval, over noise draws."""
    before: float
    after: float
    """Energy in the explainable directions over that of noise there; 1 means that only noise is left."""
    channels: tuple[ChannelClosure, ...]


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutModel:
    """Held-out motion and its explainable directions: m features, d directions, q nuisances."""

    sensitivities: Sensitivities
    whiten: Whitener
    nuisance: Array
    """Sensitivities to nuisances in units of the fitted `nuisance_unit`, in the channels' units, shape (m,
    q)."""
    Q: Array
    """Orthonormal explainable directions, shape (m, d)."""
    doubt: Array
    """Factor D of the whitened covariance D D' by uncertain nuisances, shape (m, q)."""
    sigma: Array
    """Standard deviation by noise floor and uncertain nuisances, shape (m,)."""

    @property
    def layout(self) -> FeatureLayout:
        """Layout of the held-out features."""
        return self.sensitivities.layout


def build_held_out_model(
    equations: NormalEquations, sensitivities: Sensitivities, covariance: Array
) -> HeldOutModel:
    """Build the model of held-out motion, given the fitted campaign.

    Args:
        equations: Normal equations of the fitted campaign.
        sensitivities: Sensitivities of the held-out motion.
        covariance: Covariance of the fitted nuisances, without a unit (in `nuisance_unit`), shape (q, q).

    Returns:
        The model, with its explainable directions.

    Raises:
        ValueError: A block is in both, or nuisances or hypotheses differ.
    """
    _check_disjoint(equations.layout, sensitivities.layout)
    if len(sensitivities.shared_nuisances) != equations.q or sensitivities.hypotheses != equations.hypotheses:
        raise ValueError("held-out motion must have the nuisances and the hypotheses of the campaign")
    whiten, nuisance = (
        build_whitener(sensitivities),
        sensitivities.nuisance[:, sensitivities.shared_nuisances] * equations.nuisance_unit,
    )
    N = whiten(nuisance)
    seen = equations.scale > 0.0
    size = _detectable_amplitudes(equations)[seen]
    fitted = equations.W[seen] * size[:, None]
    moved = whiten(sensitivities.effect[:, seen] * (size / equations.scale[seen])) - N @ fitted.T
    U, s, _ = np.linalg.svd(moved, full_matrices=False)
    doubt = N @ np.linalg.cholesky(covariance)
    sigma = sensitivities.layout.sigma * np.sqrt(1.0 + np.sum(doubt**2, axis=1))
    return HeldOutModel(sensitivities, whiten, nuisance, U[:, s > MIN_MOVED_SIGMAS], doubt, sigma)


def compute_closure(held_out_model: HeldOutModel, before: Array, after: Array, seed: int) -> Closure:
    """Compute the closure on held-out motion.

    Args:
        before: Residual without the findings, in the units of the channels, shape (m,).
        after: Residual with the findings, in the units of the channels, shape (m,).

    Returns:
        Closure, with every channel.
    """
    closure = whitened_closure(
        held_out_model, held_out_model.whiten(before), held_out_model.whiten(after), seed
    )
    return replace(closure, channels=_channel_closures(held_out_model, before, after))


def whitened_closure(held_out_model: HeldOutModel, r: Array, rest: Array, seed: int) -> Closure:
    """Compute the closure of whitened residuals, without channels.

    Args:
        r: Whitened residual without the findings, shape (m,).
        rest: Whitened residual with the findings, shape (m,).

    Returns:
        Closure; `channels` is empty.
    """
    d = r - rest
    Q = np.linalg.qr(np.column_stack([held_out_model.Q, d]))[0] if np.any(d) else held_out_model.Q
    along, mine = Q.T @ r, Q.T @ d
    noise_covariance = _noise_covariance(held_out_model, r, Q)
    noise = float(np.trace(noise_covariance))
    gap, removed = float(along @ along) - noise, float(r @ r - rest @ rest)
    share, least, most = np.nan, -np.inf, np.inf
    if gap > MIN_GAP_SIGMAS * np.sqrt(2.0 * np.sum(noise_covariance**2)):
        share = removed / gap
        middle = _remove_noise(along, mine, gap)
        drawn = np.random.default_rng(seed).multivariate_normal(
            middle, noise_covariance, NOISE_DRAWS, method="eigh"
        )
        gaps = np.sum(drawn**2, axis=1) - noise
        ratios = (2.0 * drawn @ mine - mine @ mine)[gaps > 0.0] / gaps[gaps > 0.0]
        least, most = _interval(ratios, share, float(np.mean(gaps > 0.0)))
    floor = max(noise, float(np.finfo(float).tiny))
    return Closure(share, least, most, (gap + floor) / floor, (gap + floor - removed) / floor, ())


def _check_disjoint(fitted: FeatureLayout, held_out: FeatureLayout) -> None:
    """Raise ValueError if a held-out block took part in fitting."""
    used, held = ({of.blocks[b] for b in np.unique(of.block)} for of in (fitted, held_out))
    both = used & held
    if both:
        raise ValueError(f"held-out motion was also used for fitting: {', '.join(sorted(both))}")


def _detectable_amplitudes(equations: NormalEquations) -> Array:
    """Return the amplitude of each column at the detection limit, in standard errors, (k,)."""
    columns = np.bincount(equations.owner, minlength=len(equations.hypotheses))
    limit = {int(k): np.sqrt(noncentrality(int(k))) for k in np.unique(columns) if k}
    return np.array([limit[int(columns[h])] for h in equations.owner])


def _noise_covariance(held_out_model: HeldOutModel, r: Array, Q: Array) -> Array:
    """Return the covariance (n, n) of noise and nuisances in a span (m, n)."""
    lever = np.sum(Q**2, axis=1)
    beside = (r - Q @ (Q.T @ r)) ** 2
    own = np.where(lever < MAX_LEVERAGE, beside / np.maximum(1.0 - lever, MAX_LEVERAGE), 1.0)
    of_nuisances = Q.T @ held_out_model.doubt
    return np.asarray((Q.T * own) @ Q + of_nuisances @ of_nuisances.T)


def _remove_noise(along: Array, d: Array, energy: float) -> Array:
    """Scale a residual to an energy without noise; the part along d stays if it can."""
    mine = d * (along @ d) / max(float(d @ d), float(np.finfo(float).tiny))
    beside, rest = along - mine, energy - float(mine @ mine)
    if rest <= 0.0:
        return np.asarray(mine * np.sqrt(energy / (mine @ mine)))
    return np.asarray(mine + beside * np.sqrt(rest / max(float(beside @ beside), rest * 1e-12)))


def _interval(ratios: Array, share: float, positive_share: float) -> tuple[float, float]:
    """Return the interval of the drawn shares; infinite if the residual is too rarely positive."""
    if positive_share < INTERVAL_QUANTILES[1]:
        return -np.inf, np.inf
    least, most = np.quantile(ratios, INTERVAL_QUANTILES)
    return float(min(least, share)), float(max(most, share))


def _channel_closures(
    held_out_model: HeldOutModel, before: Array, after: Array
) -> tuple[ChannelClosure, ...]:
    """Return the root mean squares of the channels that have features."""
    layout, result = held_out_model.layout, []
    for channel in np.unique(layout.channel):
        rows = layout.channel == channel
        parts = (float(np.sqrt(np.mean(one[rows] ** 2))) for one in (before, after, held_out_model.sigma))
        result.append(ChannelClosure(layout.channels[channel], layout.units[channel], *parts))
    return tuple(result)


def compute_held_out_residuals(
    diagnosis: Diagnosis, held_out_model: HeldOutModel, residual: Array, change: Array
) -> tuple[Array, Array]:
    """Subtract the nuisances that fit beside the findings, then the change by the findings.

    Nuisances that fit alone would imitate a finding, far beyond their priors, and hide the gap.

    Args:
        residual: Measured minus simulated with nuisances at 0, in the units of the channels, shape (m,).
        change: Simulated change by the findings, in the units of the channels, shape (m,).

    Returns:
        Residuals without and with the findings, in the units of the channels, shape (m,) each.
    """
    before = residual - held_out_model.nuisance @ diagnosis.effect_fit.theta[: diagnosis.equations.q]
    return np.asarray(before), np.asarray(before - change)


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
