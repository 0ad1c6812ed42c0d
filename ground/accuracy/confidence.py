"""How often bounds hold, and by how much they are too wide, with the intervals that sampling leaves."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import binom, chi2, norm

from fsw.kinematics.transforms import Array
from ground.common.rates import clopper_pearson

SIGMAS: Final = 3.0
UPPER_CONFIDENCE: Final = 0.95
NORMAL_QUANTILE: Final = float(norm.ppf(UPPER_CONFIDENCE))


@dataclass(frozen=True, slots=True)
class ThreeSigma:
    """Three sigma of an error's length, and what it is at most, with 95 % confidence."""

    estimate: float
    upper: float


@dataclass(frozen=True, slots=True)
class AccuracyEstimate:
    """What arms are held to."""

    accuracy: ThreeSigma
    """Of any arm, about nought."""
    repeatability: ThreeSigma
    """Of one arm, about its mean."""


def estimate_accuracy(error: Array) -> AccuracyEstimate:
    """Of errors (components, arms, errors an arm).

    Raises:
        ValueError: fewer than two arms, or than two errors of each.
    """
    _, arms, each = error.shape
    if arms < 2 or each < 2:
        raise ValueError(f"{arms} arms with {each} errors each: two arms and two errors are the least")
    mean = error.mean(axis=(1, 2))
    of_arm = error.mean(axis=2)
    between = _MeanSquare.of(np.sqrt(each) * (of_arm - mean[:, None]), arms - 1)
    within = _MeanSquare.of((error - of_arm[:, :, None]).reshape(len(error), -1), arms * (each - 1))
    # |mean|^2 is too large by what is left of both variances in it
    about_nought = max(float(mean @ mean) - between.value / (arms * each), 0.0)
    parts = ((1 / each, between), (1 - 1 / each, within))
    total = sum(share * part.value for share, part in parts)
    mean_above = 2 * NORMAL_QUANTILE * float(np.sqrt(mean @ between.S @ mean / (arms * each)))
    above = np.sqrt(mean_above**2 + sum((share * part.above()) ** 2 for share, part in parts))
    return AccuracyEstimate(
        ThreeSigma(_sigmas(about_nought + total), _sigmas(about_nought + total + above)),
        ThreeSigma(_sigmas(within.value), _sigmas(within.value + within.above())),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _MeanSquare:
    S: Array
    value: float
    degrees_of_freedom: float

    @staticmethod
    def of(deviations: Array, freedom: int) -> "_MeanSquare":
        """Of vectors (components, n) that are left with so many degrees of freedom."""
        S = deviations @ deviations.T / freedom
        total, square = float(np.trace(S)), float(np.trace(S @ S))
        return _MeanSquare(S, total, freedom * (total**2 / square if square > 0 else 1.0))

    def above(self) -> float:
        """From the mean square to the upper bound of what it estimates."""
        return self.value * (
            self.degrees_of_freedom / float(chi2.ppf(1 - UPPER_CONFIDENCE, self.degrees_of_freedom)) - 1
        )


def _sigmas(variance: float) -> float:
    return SIGMAS * float(np.sqrt(variance))


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


def estimate_coverage(error: Array, bound: Array, wanted: float, arms: int) -> Coverage:
    """Of errors and their bounds, (n,) each, from so many arms: errors of one arm are not independent.

    Intervals count arms, not errors: exact for one error an arm, too wide for more.
    """
    normed = error / bound
    share = float(np.mean(normed <= 1))
    low, wide = quantile_interval(normed, wanted, arms)
    return Coverage(
        share,
        clopper_pearson(share * arms, arms, CONFIDENCE),
        1 / float(np.quantile(normed, wanted)),
        (1 / wide, 1 / low),
    )


def min_sample_size(share: float) -> int:
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
