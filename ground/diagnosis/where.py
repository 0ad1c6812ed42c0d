"""Where the gap lies: energy of the residual over its floor, by channel, place and regime."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.interval import ENDS
from ground.diagnosis.layout import Layout

DRAWS: Final = 400


@dataclass(frozen=True, slots=True)
class Cell:
    """One channel at one place in one regime."""

    channel: str
    place: str
    regime: str
    features: int
    ratio: float
    """Root mean square of the residual over its floor: 1 if there is no gap."""
    least: float
    most: float
    """90 % interval of that, from a bootstrap over blocks; NaN if there is one block only."""


def where(layout: Layout, residual: Array, seed: int) -> tuple[Cell, ...]:
    """Of residuals in units of their floor (m,), largest first."""
    rng = np.random.default_rng(seed)
    count = len(layout.blocks)
    weight = rng.multinomial(count, np.full(count, 1.0 / count), size=DRAWS).astype(float)
    result = []
    of = np.stack([layout.channel, layout.place, layout.regime])
    for channel, place, regime in np.unique(of, axis=1).T:
        rows = np.flatnonzero(np.all(of == [[channel], [place], [regime]], axis=0))
        n = np.bincount(layout.block[rows], minlength=count)
        square = np.bincount(layout.block[rows], residual[rows] ** 2, minlength=count)
        least, most = _interval(weight @ square, weight @ n) if np.count_nonzero(n) > 1 else (np.nan, np.nan)
        result.append(Cell(
            layout.channels[channel], layout.places[place], layout.regimes[regime], rows.size,
            float(np.sqrt(square.sum() / n.sum())), least, most,
        ))  # fmt: skip
    return tuple(sorted(result, key=lambda cell: -cell.ratio))


def _interval(square: Array, n: Array) -> tuple[float, float]:
    """Of ratios drawn."""
    ratios = np.sqrt(square[n > 0.0] / n[n > 0.0])
    least, most = np.quantile(ratios, ENDS)
    return float(least), float(most)
