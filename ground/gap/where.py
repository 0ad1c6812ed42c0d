"""Where the gap lies: energy of the residual over its floor, by channel and regime, with intervals."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.layout import Layout

DRAWS: Final = 400
LEVEL: Final = 0.9


@dataclass(frozen=True, slots=True)
class Cell:
    """One channel in one regime."""

    channel: str
    place: str
    regime: str
    features: int
    ratio: float
    """Root mean square of the residual over its floor: 1 if there is no gap."""
    least: float
    most: float
    """90 % interval of that, from a bootstrap over blocks."""


def where(layout: Layout, residual: Array, seed: int) -> tuple[Cell, ...]:
    """Of residuals in units of their floor (m,), largest first."""
    rng = np.random.default_rng(seed)
    count = len(layout.blocks)
    weight = rng.multinomial(count, np.full(count, 1.0 / count), size=DRAWS).astype(float)
    result = []
    for channel, regime in np.unique(np.stack([layout.channel, layout.regime]), axis=1).T:
        rows = np.flatnonzero((layout.channel == channel) & (layout.regime == regime))
        n = np.bincount(layout.block[rows], minlength=count)
        square = np.bincount(layout.block[rows], residual[rows] ** 2, minlength=count)
        drawn = weight @ n > 0.0
        ratios = np.sqrt((weight[drawn] @ square) / (weight[drawn] @ n))
        least, most = np.quantile(ratios, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
        place = layout.places[int(np.argmax(np.bincount(layout.place[rows])))]
        result.append(Cell(
            layout.channels[channel], place, layout.regimes[regime], rows.size,
            float(np.sqrt(square.sum() / n.sum())), float(least), float(most),
        ))  # fmt: skip
    return tuple(sorted(result, key=lambda cell: -cell.ratio))
