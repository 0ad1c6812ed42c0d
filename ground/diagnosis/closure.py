"""How far the gap shrinks on motions that took no part in fitting or choosing.

With nuisances as fitted without effect, the whitened residual there is r; with effects, and nuisances as
fitted beside them, r - d. What can be explained lies in a span Q: the directions in which the hypotheses,
each as large as it must be to be seen where it was fitted, move that motion clearly, and d. Its energy is
|Q'r|^2, less what is there by chance. That is what the nuisances leave, N C N', and every feature's own
noise. A floor that is assumed may be too high, so that is measured by what lies beside the span,
e = r - QQ'r, with the leverage h = diag QQ': e_i^2 / (1 - h_i) (HC2, MacKinnon and White 1985). The share
closed is (|r|^2 - |r - d|^2) / (|Q'r|^2 - chance).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.detect import noncentrality
from ground.diagnosis.interval import ENDS
from ground.diagnosis.layout import Layout
from ground.diagnosis.prepared import Prepared
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.whiten import Whitener, whitener

DRAWS: Final = 2000
LOST: Final = 2.0
"""An explainable gap of less than so many sigmas of what is there by chance cannot be shared out."""
MOVES: Final = 2.0
"""Sigmas by which effects that can just be seen together move what may be explained."""
LEVER: Final = 0.5
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
class HeldOut:
    """Motion that took no part, and what can be explained there: m features, d directions, q nuisances."""

    found: Sensitivities
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
    def layout(self) -> Layout:
        """Its features."""
        return self.found.layout


def apart_from(prepared: Prepared, found: Sensitivities) -> HeldOut:
    """Held-out motion, beside what is fitted.

    Raises:
        ValueError: a block is in both, or nuisances or hypotheses are others.
    """
    _check_apart(prepared.layout, found.layout)
    if len(found.lasting) != prepared.q or found.hypotheses != prepared.hypotheses:
        raise ValueError("held-out motion must have the nuisances and the hypotheses of the campaign")
    whiten, nuisance = whitener(found), found.nuisance[:, found.lasting] * prepared.nuisance_unit
    N = whiten(nuisance)
    seen = prepared.scale > 0.0
    size = _just_seen(prepared)[seen]
    fitted = prepared.W[-1][seen] * size[:, None]
    moved = whiten(found.effect[:, seen] * (size / prepared.scale[seen])) - N @ fitted.T
    U, s, _ = np.linalg.svd(moved, full_matrices=False)
    doubt = N @ np.linalg.cholesky(prepared.C[-1])
    sigma = found.layout.sigma * np.sqrt(1.0 + np.sum(doubt**2, axis=1))
    return HeldOut(found, whiten, nuisance, U[:, s > MOVES], doubt, sigma)


def closure(apart: HeldOut, before: Array, after: Array, seed: int) -> Closure:
    """Of residuals (m,) in the channels' units."""
    told = closed(apart, apart.whiten(before), apart.whiten(after), seed)
    return replace(told, channels=_channels(apart, before, after))


def closed(apart: HeldOut, r: Array, rest: Array, seed: int) -> Closure:
    """Of whitened residuals (m,) before and after; channels are not told."""
    d = r - rest
    Q = np.linalg.qr(np.column_stack([apart.Q, d]))[0] if np.any(d) else apart.Q
    along, mine = Q.T @ r, Q.T @ d
    chance = _chance(apart, r, Q)
    noise = float(np.trace(chance))
    gap, less = float(along @ along) - noise, float(r @ r - rest @ rest)
    share, least, most = np.nan, -np.inf, np.inf
    if gap > LOST * np.sqrt(2.0 * np.sum(chance**2)):
        share = less / gap
        middle = _signal(along, mine, gap)
        drawn = np.random.default_rng(seed).multivariate_normal(middle, chance, DRAWS, method="eigh")
        gaps = np.sum(drawn**2, axis=1) - noise
        ratios = (2.0 * drawn @ mine - mine @ mine)[gaps > 0.0] / gaps[gaps > 0.0]
        least, most = _interval(ratios, share, float(np.mean(gaps > 0.0)))
    floor = max(noise, float(np.finfo(float).tiny))
    return Closure(share, least, most, (gap + floor) / floor, (gap + floor - less) / floor, ())


def _check_apart(fitted: Layout, held_out: Layout) -> None:
    """ValueError if a block took part in fitting."""
    used, held = ({of.blocks[b] for b in np.unique(of.block)} for of in (fitted, held_out))
    both = used & held
    if both:
        raise ValueError(f"held-out motion was also used for fitting: {', '.join(sorted(both))}")


def _just_seen(prepared: Prepared) -> Array:
    """How large each column must be for its hypothesis to be seen, in standard errors, (K,)."""
    columns = np.bincount(prepared.owner, minlength=len(prepared.hypotheses))
    limit = {int(k): np.sqrt(noncentrality(int(k))) for k in np.unique(columns) if k}
    return np.array([limit[int(columns[h])] for h in prepared.owner])


def _chance(apart: HeldOut, r: Array, Q: Array) -> Array:
    """Covariance of what noise and nuisances do in a span (m, n), (n, n)."""
    lever = np.sum(Q**2, axis=1)
    beside = (r - Q @ (Q.T @ r)) ** 2
    own = np.where(lever < LEVER, beside / np.maximum(1.0 - lever, LEVER), 1.0)
    of_nuisances = Q.T @ apart.doubt
    return np.asarray((Q.T * own) @ Q + of_nuisances @ of_nuisances.T)


def _signal(along: Array, d: Array, energy: float) -> Array:
    """Of this energy, without what chance added to it: as it was along d, as far as it can be."""
    mine = d * (along @ d) / max(float(d @ d), float(np.finfo(float).tiny))
    beside, rest = along - mine, energy - float(mine @ mine)
    if rest <= 0.0:
        return np.asarray(mine * np.sqrt(energy / (mine @ mine)))
    return np.asarray(mine + beside * np.sqrt(rest / max(float(beside @ beside), rest * 1e-12)))


def _interval(ratios: Array, share: float, told: float) -> tuple[float, float]:
    """Of ratios drawn; everything if the gap is not positive in as many draws as the interval leaves out."""
    if told < ENDS[1]:
        return -np.inf, np.inf
    least, most = np.quantile(ratios, ENDS)
    return float(min(least, share)), float(max(most, share))


def _channels(apart: HeldOut, before: Array, after: Array) -> tuple[ChannelClosure, ...]:
    """Those that have features."""
    layout, result = apart.layout, []
    for channel in np.unique(layout.channel):
        rows = layout.channel == channel
        parts = (float(np.sqrt(np.mean(one[rows] ** 2))) for one in (before, after, apart.sigma))
        result.append(ChannelClosure(layout.channels[channel], layout.units[channel], *parts))
    return tuple(result)
