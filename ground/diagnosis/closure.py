"""A diagnosis tried on motions that took no part in it."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.detectability import noncentrality
from ground.diagnosis.diagnose import Diagnosis
from ground.diagnosis.normal_equations import NormalEquations, Whitener, build_whitener
from ground.diagnosis.problem import INTERVAL_QUANTILES, FeatureLayout, Hypothesis
from ground.diagnosis.sensitivity import Sensitivities

NOISE_DRAWS: Final = 2000
MIN_GAP_SIGMAS: Final = 2.0
"""An explainable gap of less than so many sigmas of what is there by chance cannot be shared out."""
MIN_MOVED_SIGMAS: Final = 2.0
"""Sigmas by which effects that can just be seen together move what may be explained."""
MAX_LEVERAGE: Final = 0.5
"""A feature of more leverage tells too little of its own noise: it has its floor's."""


@dataclass(frozen=True, slots=True)
class ChannelClosure:
    """One channel on held-out motion, root mean squares in its unit."""

    channel: str
    unit: str
    before: float
    after: float
    floor: float


@dataclass(frozen=True, slots=True)
class Closure:
    """Share of the explainable gap that is closed; NaN, with an interval of everything, if hardly any is."""

    share: float
    least: float
    most: float
    """90 % interval, noise drawn anew."""
    before: float
    after: float
    """Energy of what can be explained over what is there by chance: 1 where nothing is left."""
    channels: tuple[ChannelClosure, ...]


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutModel:
    """Motion that took no part, and what can be explained there: m features, d directions, q nuisances."""

    sensitivities: Sensitivities
    whiten: Whitener
    nuisance: Array
    """What nuisances do, 1 of each as the fitted motion counts them, in the channels' units, (m, q)."""
    Q: Array
    """Directions, orthonormal, (m, d)."""
    doubt: Array
    """What nuisances leave in whitened features: its covariance is this times its transpose, (m, q)."""
    sigma: Array
    """The floor and what nuisances leave, (m,)."""

    @property
    def layout(self) -> FeatureLayout:
        """Its features."""
        return self.sensitivities.layout


def build_held_out_model(equations: NormalEquations, sensitivities: Sensitivities) -> HeldOutModel:
    """Held-out motion, beside what is fitted.

    Raises:
        ValueError: a block is in both, or nuisances or hypotheses are others.
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
    fitted = equations.W[-1][seen] * size[:, None]
    moved = whiten(sensitivities.effect[:, seen] * (size / equations.scale[seen])) - N @ fitted.T
    U, s, _ = np.linalg.svd(moved, full_matrices=False)
    doubt = N @ np.linalg.cholesky(equations.C[-1])
    sigma = sensitivities.layout.sigma * np.sqrt(1.0 + np.sum(doubt**2, axis=1))
    return HeldOutModel(sensitivities, whiten, nuisance, U[:, s > MIN_MOVED_SIGMAS], doubt, sigma)


def compute_closure(held_out_model: HeldOutModel, before: Array, after: Array, seed: int) -> Closure:
    """Of residuals (m,) in the channels' units."""
    told = whitened_closure(held_out_model, held_out_model.whiten(before), held_out_model.whiten(after), seed)
    return replace(told, channels=_channel_closures(held_out_model, before, after))


def whitened_closure(held_out_model: HeldOutModel, r: Array, rest: Array, seed: int) -> Closure:
    """Of whitened residuals (m,) before and after; channels are not told."""
    d = r - rest
    Q = np.linalg.qr(np.column_stack([held_out_model.Q, d]))[0] if np.any(d) else held_out_model.Q
    along, mine = Q.T @ r, Q.T @ d
    chance = _noise_covariance(held_out_model, r, Q)
    noise = float(np.trace(chance))
    gap, less = float(along @ along) - noise, float(r @ r - rest @ rest)
    share, least, most = np.nan, -np.inf, np.inf
    if gap > MIN_GAP_SIGMAS * np.sqrt(2.0 * np.sum(chance**2)):
        share = less / gap
        middle = _remove_noise(along, mine, gap)
        drawn = np.random.default_rng(seed).multivariate_normal(middle, chance, NOISE_DRAWS, method="eigh")
        gaps = np.sum(drawn**2, axis=1) - noise
        ratios = (2.0 * drawn @ mine - mine @ mine)[gaps > 0.0] / gaps[gaps > 0.0]
        least, most = _interval(ratios, share, float(np.mean(gaps > 0.0)))
    floor = max(noise, float(np.finfo(float).tiny))
    return Closure(share, least, most, (gap + floor) / floor, (gap + floor - less) / floor, ())


def _check_disjoint(fitted: FeatureLayout, held_out: FeatureLayout) -> None:
    """ValueError if a block took part in fitting."""
    used, held = ({of.blocks[b] for b in np.unique(of.block)} for of in (fitted, held_out))
    both = used & held
    if both:
        raise ValueError(f"held-out motion was also used for fitting: {', '.join(sorted(both))}")


def _detectable_amplitudes(equations: NormalEquations) -> Array:
    """How large each column must be for its hypothesis to be seen, in standard errors, (K,)."""
    columns = np.bincount(equations.owner, minlength=len(equations.hypotheses))
    limit = {int(k): np.sqrt(noncentrality(int(k))) for k in np.unique(columns) if k}
    return np.array([limit[int(columns[h])] for h in equations.owner])


def _noise_covariance(held_out_model: HeldOutModel, r: Array, Q: Array) -> Array:
    """Covariance of what noise and nuisances do in a span (m, n), (n, n)."""
    lever = np.sum(Q**2, axis=1)
    beside = (r - Q @ (Q.T @ r)) ** 2
    own = np.where(lever < MAX_LEVERAGE, beside / np.maximum(1.0 - lever, MAX_LEVERAGE), 1.0)
    of_nuisances = Q.T @ held_out_model.doubt
    return np.asarray((Q.T * own) @ Q + of_nuisances @ of_nuisances.T)


def _remove_noise(along: Array, d: Array, energy: float) -> Array:
    """Of this energy, without what chance added to it: as it was along d, as far as it can be."""
    mine = d * (along @ d) / max(float(d @ d), float(np.finfo(float).tiny))
    beside, rest = along - mine, energy - float(mine @ mine)
    if rest <= 0.0:
        return np.asarray(mine * np.sqrt(energy / (mine @ mine)))
    return np.asarray(mine + beside * np.sqrt(rest / max(float(beside @ beside), rest * 1e-12)))


def _interval(ratios: Array, share: float, told: float) -> tuple[float, float]:
    """Of ratios drawn; everything if the gap is not positive in as many draws as the interval leaves out."""
    if told < INTERVAL_QUANTILES[1]:
        return -np.inf, np.inf
    least, most = np.quantile(ratios, INTERVAL_QUANTILES)
    return float(min(least, share)), float(max(most, share))


def _channel_closures(
    held_out_model: HeldOutModel, before: Array, after: Array
) -> tuple[ChannelClosure, ...]:
    """Those that have features."""
    layout, result = held_out_model.layout, []
    for channel in np.unique(layout.channel):
        rows = layout.channel == channel
        parts = (float(np.sqrt(np.mean(one[rows] ** 2))) for one in (before, after, held_out_model.sigma))
        result.append(ChannelClosure(layout.channels[channel], layout.units[channel], *parts))
    return tuple(result)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutResiduals:
    """What is left on held-out motion without the findings and with them, (m,) in the channels' units."""

    held_out_model: HeldOutModel
    before: Array
    after: Array

    def closure(self, seed: int) -> Closure:
        """How far the gap shrinks."""
        return compute_closure(self.held_out_model, self.before, self.after, seed)


def compute_held_out_residuals(
    diagnosis: Diagnosis, held_out_model: HeldOutModel, gap: Array, change: Array
) -> HeldOutResiduals:
    """Nuisances as fitted elsewhere are taken off, and what the findings change.

    `gap` (m,) is measured less simulated with nuisances at 0; `change` (m,) is by the simulator.
    """
    q = diagnosis.equations.q
    before, after = (
        gap - held_out_model.nuisance @ fit.theta[:q] for fit in (diagnosis.null_fit, diagnosis.effect_fit)
    )
    return HeldOutResiduals(held_out_model, np.asarray(before), np.asarray(after - change))


def effect_values(diagnosis: Diagnosis) -> dict[Hypothesis, Array]:
    """The findings as a simulator takes them."""
    hypotheses = diagnosis.equations.hypotheses
    return {hypotheses[finding.hypothesis]: finding.values for finding in diagnosis.findings}
