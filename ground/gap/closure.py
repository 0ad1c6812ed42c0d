"""How far the gap shrinks on motions that took no part in fitting or choosing.

With nuisances as fitted without effect, the energy of the whitened residual is E0; with effects, and
nuisances as fitted beside them, E1; the floor alone gives n, the number of features. The share closed is (E0
- E1) / (E0 - n).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.layout import Layout

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


def closure(layout: Layout, whitened: tuple[Array, Array], raw: tuple[Array, Array], seed: int) -> Closure:
    """Of residuals (m,) before and after, whitened and in the channels' units, on held-out features."""
    count = len(layout.blocks)
    n = np.bincount(layout.block, minlength=count).astype(float)
    E0, E1 = (np.bincount(layout.block, one**2, minlength=count) for one in whitened)
    used = n > 0.0
    n, E0, E1 = n[used], E0[used], E1[used]
    rng = np.random.default_rng(seed)
    weight = rng.multinomial(n.size, np.full(n.size, 1.0 / n.size), size=DRAWS)
    gap = weight @ (E0 - n)
    closed = weight @ (E0 - E1)
    small = LOST * np.sqrt(2.0 * n.sum())
    share, least, most = np.nan, -np.inf, np.inf
    if (E0 - n).sum() > small:
        share = float((E0 - E1).sum() / (E0 - n).sum())
        told = gap > 0.0
        least, most = _interval(closed[told] / gap[told], share, float(np.mean(told)))
    return Closure(
        share, least, most, float(E0.sum() / n.sum()), float(E1.sum() / n.sum()), _channels(layout, raw)
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


def _channels(layout: Layout, raw: tuple[Array, Array]) -> tuple[ChannelClosure, ...]:
    """Those that have features."""
    result = []
    for channel in np.unique(layout.channel):
        rows = layout.channel == channel
        before, after, floor = (float(np.sqrt(np.mean(one[rows] ** 2))) for one in (*raw, layout.sigma))
        result.append(ChannelClosure(layout.channels[channel], layout.units[channel], before, after, floor))
    return tuple(result)
