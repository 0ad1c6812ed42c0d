"""Proportions of hits and medians with exact confidence intervals, and exact tests of proportions."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np
from scipy.stats import beta, binom

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

    def __str__(self) -> str:
        if not self.of:
            return "no case"
        between = f"{100 * self.least:.1f} to {100 * self.most:.1f}"
        return f"{100 * self.share:.1f} % ({self.hits} of {self.of}; {between})"


@dataclass(frozen=True, slots=True)
class Median:
    """Median with its exact interval; NaN with an infinite interval if there are no values."""

    of: int
    median: float
    least: float
    most: float

    def __str__(self) -> str:
        if not self.of:
            return "no case"
        between = "too few to say"
        if isfinite(self.most):
            between = f"{100 * self.least:.1f} to {100 * self.most:.1f}"
        return f"{100 * self.median:.1f} % (of {self.of}; {between})"


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


def median_with_interval(values: Sequence[float]) -> Median:
    """Return the median, with an interval between two of the values by the binomial distribution."""
    known = np.sort([value for value in values if np.isfinite(value)])
    if not known.size:
        return Median(0, float("nan"), float("-inf"), float("inf"))
    below = int(binom.ppf((1.0 - LEVEL) / 2.0, known.size, 0.5)) - 1
    least, most = (known[below], known[-1 - below]) if below >= 0 else (-np.inf, np.inf)
    return Median(known.size, float(np.median(known)), float(least), float(most))


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
    fewer have it. The number of hits is not necessarily whole, as it is for `scipy.stats.binomtest`.

    Raises:
        ValueError: not 0 <= hits <= of.
    """
    if not 0 <= hits <= of:
        raise ValueError(f"{hits} hits of {of}")
    tail = (1.0 - level) / 2.0
    least = float(beta.ppf(tail, hits, of - hits + 1)) if hits else 0.0
    most = float(beta.isf(tail, hits + 1, of - hits)) if hits < of else 1.0
    return least, most
