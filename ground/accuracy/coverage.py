"""How often bounds hold, and by how much they are too wide, with the intervals that sampling leaves."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import binom

from fsw.kinematics.transforms import Array
from ground.common.rates import interval

CONFIDENCE: Final = 0.95

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Coverage:
    """A bound, pose by pose, against the errors that were measured there."""

    share: float
    """Of the errors that are within their bounds."""
    share_interval: Interval
    width: float
    """Bound over the error that the wanted share stays within: 1 is just right, more is too wide."""
    width_interval: Interval

    def holds(self, wanted: float) -> bool:
        """Whether so much coverage is within the sampling interval, or below it."""
        return self.share_interval[1] >= wanted


def coverage(error: Array, bound: Array, wanted: float, arms: int) -> Coverage:
    """Of errors and their bounds, (n,) each, from so many arms: errors of one arm are not independent.

    Intervals count arms, not errors: exact for one error an arm, too wide for more.
    """
    normed = error / bound
    share = float(np.mean(normed <= 1))
    low, wide = quantile_interval(normed, wanted, arms)
    return Coverage(
        share,
        interval(share * arms, arms, CONFIDENCE),
        1 / float(np.quantile(normed, wanted)),
        (1 / wide, 1 / low),
    )


def enough_for(share: float) -> int:
    """How many independent values say, with confidence, what the quantile of this share is at most."""
    return int(np.ceil(np.log((1 - CONFIDENCE) / 2) / np.log(share)))


def quantile_interval(values: Array, share: float, count: int) -> Interval:
    """Between which values the quantile of this share lies, by the ranks of `count` independent ones.

    Infinity where there are too few to say.
    """
    tail = (1 - CONFIDENCE) / 2
    below, most = (int(binom.ppf(p, count, share)) for p in (tail, 1 - tail))
    # so many values lie below it, at least and at most: of those in order the next one lies above it
    low = float(np.quantile(values, (below - 1) / max(count - 1, 1))) if below > 0 else -np.inf
    high = float(np.quantile(values, most / (count - 1))) if most < count else np.inf
    return low, high
