"""Proportions of hits with exact confidence intervals, and exact tests of proportions.

Intervals of three-sigma accuracy, of the coverage of bounds, and of their width.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import beta, binom, chi2, norm

from fsw.kinematics.transforms import Array

LEVEL: Final = 0.95
TEST_LEVEL: Final = 0.05


@dataclass(frozen=True, slots=True)
class Rate:
    """Proportion of hits with its exact confidence interval, which is 0 to 1 if there was no case."""

    hits: int
    of: int
    """Number of cases."""
    share: float
    """Observed proportion; NaN if there was no case."""
    least: float
    """Lower end of the interval."""
    most: float
    """Upper end of the interval."""


@dataclass(frozen=True, slots=True)
class RateBar:
    """Proportion with its bar: at most, or at least, `rate`; missed if an exact test at 5 % rejects it."""

    hits: int
    of: int
    rate: float
    is_most: bool
    p: float
    """Probability of a count as bad or worse at exactly this rate."""

    @property
    def is_met(self) -> bool:
        """False if the test rejects the rate."""
        return self.p >= TEST_LEVEL


def check_rate(outcomes: Iterable[bool], rate: float, is_most: bool) -> RateBar:
    """Test a proportion by the binomial distribution."""
    found = list(outcomes)
    hits, of = sum(found), len(found)
    p = binom.sf(hits - 1, of, rate) if is_most else binom.cdf(hits, of, rate)
    return RateBar(hits, of, rate, is_most, float(p) if of else 1.0)


def rate_of(outcomes: Iterable[bool]) -> Rate:
    """Estimate the proportion of hits."""
    found = list(outcomes)
    return estimate_rate(sum(found), len(found))


def estimate_rate(hits: int, of: int) -> Rate:
    """Estimate a proportion with its interval; ValueError if it is not a proportion."""
    return Rate(hits, of, hits / of if of else float("nan"), *clopper_pearson(hits, of))


def clopper_pearson(hits: float, of: int, level: float = LEVEL) -> tuple[float, float]:
    """Compute the exact confidence interval of the probability of a hit (Clopper and Pearson 1934).

    At the lower end, as many hits or more have the probability (1 - level) / 2. At the upper end, as many or
    fewer have it. The number of hits, 0 to `of`, is not necessarily whole, as for `scipy.stats.binomtest`.
    """
    if not 0 <= hits <= of:
        raise ValueError(f"{hits} hits of {of}")
    tail = (1.0 - level) / 2.0
    least = float(beta.ppf(tail, hits, of - hits + 1)) if hits else 0.0
    most = float(beta.isf(tail, hits + 1, of - hits)) if hits < of else 1.0
    return least, most


SIGMAS: Final = 3.0
UPPER_CONFIDENCE: Final = 0.95
NORMAL_QUANTILE: Final = float(norm.ppf(UPPER_CONFIDENCE))
CONFIDENCE: Final = 0.95
Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ThreeSigma:
    """Three sigma of an error length, with its upper 95 % confidence bound."""

    estimate: float
    upper: float


@dataclass(frozen=True, slots=True)
class AccuracyEstimate:
    """Accuracy and repeatability as arms are specified."""

    accuracy: ThreeSigma
    """Error of any arm about zero."""
    repeatability: ThreeSigma
    """Error of one arm about its mean."""


def estimate_accuracy(error: Array) -> AccuracyEstimate:
    """Estimate accuracy and repeatability by variance within and between arms, (components, arms, errors)."""
    _, arms, each = error.shape
    if arms < 2 or each < 2:
        raise ValueError(f"{arms} arms with {each} errors each: two arms and two errors are the least")
    mean = error.mean(axis=(1, 2))
    of_arm = error.mean(axis=2)
    between = _MeanSquare.of(np.sqrt(each) * (of_arm - mean[:, None]), arms - 1)
    within = _MeanSquare.of((error - of_arm[:, :, None]).reshape(len(error), -1), arms * (each - 1))
    # |mean|^2 is biased upward by the variance of the mean
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
    def of(deviations: Array, degrees_of_freedom: int) -> "_MeanSquare":
        """Compute the mean square of vectors (components, n) with these degrees of freedom."""
        S = deviations @ deviations.T / degrees_of_freedom
        total, square = float(np.trace(S)), float(np.trace(S @ S))
        return _MeanSquare(S, total, degrees_of_freedom * (total**2 / square if square > 0 else 1.0))

    def above(self) -> float:
        """Compute the distance from the mean square to the upper bound of the variance."""
        return self.value * (
            self.degrees_of_freedom / float(chi2.ppf(1 - UPPER_CONFIDENCE, self.degrees_of_freedom)) - 1
        )


def _sigmas(variance: float) -> float:
    return SIGMAS * float(np.sqrt(variance))


@dataclass(frozen=True, slots=True)
class Coverage:
    """Comparison of bounds with measured errors at the same poses."""

    share: float
    """Share of errors within their bounds."""
    share_interval: Interval
    width: float
    """Ratio of the bound to the error length that the wanted share does not exceed; above 1 is too wide."""
    width_interval: Interval

    def holds(self, wanted: float) -> bool:
        """Return whether the wanted coverage is within the sampling interval or below it."""
        return self.share_interval[1] >= wanted


def estimate_coverage(error: Array, bound: Array, wanted: float, arms: int) -> Coverage:
    """Estimate coverage and width of bounds, (n,), of errors at the same poses.

    Errors of one arm are not independent, so the intervals count arms: exact for one error an arm, too wide
    for more.
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
    """Compute the number of independent values that bounds the quantile of this share from above."""
    return int(np.ceil(np.log((1 - CONFIDENCE) / 2) / np.log(share)))


def quantile_interval(values: Array, share: float, count: int) -> Interval:
    """Compute a confidence interval of a quantile by the ranks of values, (n,), `count` of them independent.

    The interval is around the quantile of these values; its upper end is infinite for too few of them.
    """
    tail = (1 - CONFIDENCE) / 2
    below, most = (int(binom.ppf(p, count, share)) for p in (tail, 1 - tail))
    # binomial bounds of the number of values below the quantile give the ranks of the interval
    # several values of one arm: their own quantile may be below the value of that rank
    low = float(np.quantile(values, min((below - 1) / max(count - 1, 1), share))) if below > 0 else -np.inf
    high = float(np.quantile(values, most / (count - 1))) if most < count else np.inf
    return low, high


def describe_sample(count: int, kind: str, share: float) -> str:
    """Say how many values a bound of this share rests on, and how many it needs if they are too few."""
    enough = min_sample_size(share)
    return f"{count} {kind}" if count >= enough else f"{count} of {enough} {kind}"


def is_within(interval: Interval, bound: float) -> bool | None:
    """Return whether a value with this interval stays within a bound; None if the interval holds it."""
    low, high = interval
    return True if high <= bound else False if low > bound else None
