"""How far the gap shrinks on motions that took no part in fitting or choosing.

With nuisances as fitted without effect, the energy of the whitened residual is E0; with effects, and
nuisances as fitted beside them, E1; the floor, and what is not known of the nuisances, give n. The share
closed is (E0 - E1) / (E0 - n).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.layout import Layout
from ground.gap.prepared import Prepared
from ground.gap.sensitivity import Sensitivities
from ground.gap.whiten import whitener

DRAWS: Final = 2000
LEVEL: Final = 0.9
LOST: Final = 2.0
"""An explainable gap of less than this many sigmas of the floor's own energy cannot be shared out."""


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
    """90 % interval, from a bootstrap over held-out blocks."""
    before: float
    after: float
    """E0 / n and E1 / n: 1 at the floor."""
    channels: tuple[ChannelClosure, ...]


def closure(
    layout: Layout, whitened: tuple[Array, Array], raw: tuple[Array, Array], seed: int, unsure: Array
) -> Closure:
    """Of residuals (m,) before and after, whitened and in the channels' units, on held-out features.

    `unsure` (m,) is the variance, in that of the floor, that nuisances as fitted elsewhere leave here: no
    effect can close it.
    """
    count = len(layout.blocks)
    used = np.bincount(layout.block, minlength=count) > 0
    n, E0, E1 = (
        np.bincount(layout.block, one, minlength=count)[used]
        for one in (1.0 + unsure, whitened[0] ** 2, whitened[1] ** 2)
    )
    rng = np.random.default_rng(seed)
    weight = rng.multinomial(n.size, np.full(n.size, 1.0 / n.size), size=DRAWS)
    gap = weight @ (E0 - n)
    closed = weight @ (E0 - E1)
    small = LOST * np.sqrt(2.0 * np.sum((1.0 + unsure) ** 2))
    share, least, most = np.nan, -np.inf, np.inf
    if (E0 - n).sum() > small:
        share = float((E0 - E1).sum() / (E0 - n).sum())
        told = gap > 0.0
        least, most = _interval(closed[told] / gap[told], share, float(np.mean(told)))
    return Closure(
        share,
        least,
        most,
        float(E0.sum() / n.sum()),
        float(E1.sum() / n.sum()),
        _channels(layout, raw, layout.sigma * np.sqrt(1.0 + unsure)),
    )


def check_apart(fitted: Layout, held_out: Layout) -> None:
    """ValueError if a block took part in fitting."""
    used, held = ({of.blocks[b] for b in np.unique(of.block)} for of in (fitted, held_out))
    both = used & held
    if both:
        raise ValueError(f"held-out motion was also used for fitting: {', '.join(sorted(both))}")


def _interval(ratios: Array, share: float, told: float) -> tuple[float, float]:
    """Of ratios drawn; everything if the gap is not positive in as many draws as the interval leaves out."""
    if told < LEVEL + (1.0 - LEVEL) / 2.0:
        return -np.inf, np.inf
    least, most = np.quantile(ratios, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return float(min(least, share)), float(max(most, share))


def unsure(prepared: Prepared, found: Sensitivities) -> Array:
    """Variance, in that of the floor, that nuisances as a campaign tells them leave elsewhere, (m,)."""
    N = whitener(found)(found.nuisance[:, found.lasting] * prepared.nuisance_unit)
    return np.asarray(np.sum((N @ prepared.C[-1]) * N, axis=1))


def _channels(layout: Layout, raw: tuple[Array, Array], floor_of: Array) -> tuple[ChannelClosure, ...]:
    """Those that have features."""
    result = []
    for channel in np.unique(layout.channel):
        rows = layout.channel == channel
        before, after, floor = (float(np.sqrt(np.mean(one[rows] ** 2))) for one in (*raw, floor_of))
        result.append(ChannelClosure(layout.channels[channel], layout.units[channel], before, after, floor))
    return tuple(result)
