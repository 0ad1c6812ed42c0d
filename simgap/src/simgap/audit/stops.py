"""Values at which something stops although its command goes on."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.stats import binom

from simgap.arrays import Array, Flags, Integers
from simgap.audit.samples import robust_sigma, runs

CANDIDATES: Final = 200
"""Values that are tried: the best of them is within half a percent of the travel."""
BEYOND: Final = 2.0
"""Standard deviations by which the free value is beyond a stop where something is surely held."""
DEPTH: Final = 4.0
"""Standard deviations that an excursion must go beyond: its slope is then known, as derived at MAX_SLOPE."""
MAX_SLOPE: Final = 0.3
"""Slope of measured over free values beyond a stop. Free motion has slope 1, or 0.57 where the free values
spread evenly over DEPTH sigmas and have an error of one: 16 / 12 / (16 / 12 + 1). A stop has slope 0."""
LEAST_EXCURSIONS: Final = 3
"""Excursions that must agree: two may be one coincidence repeated."""
MAX_PASSED: Final = 0.2
"""Samples that may pass a stop, over those whose free value does: 0 at a stop and 1 for free motion. A few do
because the site is not the point of contact, so that its height there changes with its direction."""
LEAST_SHARE: Final = 0.005
"""Least standard deviation as a share of the travel: with DEPTH, less than 2 % is not worth a remark."""
LEVEL: Final = 0.9


@dataclass(frozen=True, slots=True)
class Stop:
    """A lower stop of some quantity."""

    noise: float
    """Standard deviation of measured less free values where nothing stops."""
    is_sure: Flags
    """Samples whose free value is surely beyond it, (n,)."""
    excursions: tuple[tuple[int, int], ...]
    """Begin and end (exclusive) of the excursions that show it, in samples."""
    levels: Array
    """Median measured value of each of them."""
    furthest: float
    """That of the excursion that was commanded furthest beyond."""


def find_lower_stop(free: Array, measured: Array, motion: Integers, least_sigma: float) -> Stop | None:
    """Find a value below which the free value goes and the measured one does not, in several excursions.

    Args:
        free: Predicted values if nothing stops, (n,), any unit; NaN where not known.
        measured: Measured values, (n,), in the same unit.
        motion: Index of the motion of each sample, (n,); an excursion ends with its motion.
        least_sigma: Least standard deviation of the prediction to assume, in the same unit.

    Returns:
        The stop, or None.
    """
    known = np.isfinite(free) & np.isfinite(measured)
    if known.sum() < LEAST_EXCURSIONS:
        return None
    noise = robust_sigma((measured - free)[known])
    sigma = max(noise, least_sigma, LEAST_SHARE * float(np.ptp(measured[known])))
    value = _best_level(free[known], measured[known])
    beyond = np.where(known, value - free, -np.inf)
    is_sure = beyond > BEYOND * sigma
    if np.sum(measured[known] < value - BEYOND * sigma) > MAX_PASSED * is_sure.sum():
        return None
    every = _excursions(beyond > 0.0, motion)
    found = [one for one in every if _is_stopped(free[slice(*one)], measured[slice(*one)], value, sigma)]
    if len(found) < LEAST_EXCURSIONS:
        return None
    levels = np.array([np.median(measured[b:e][is_sure[b:e]]) for b, e in found])
    deepest = int(np.argmin([free[b:e].min() for b, e in found]))
    return Stop(noise, is_sure, tuple(found), levels, float(levels[deepest]))


def median_interval(values: Array) -> tuple[float, float]:
    """Return the 90 % interval of the median from the order of values (n,); all of them if they are few."""
    ordered = np.sort(values)
    cut = 0
    while 2 * (cut + 1) < ordered.size and binom.cdf(cut, ordered.size, 0.5) <= (1.0 - LEVEL) / 2.0:
        cut += 1
    cut = max(cut - 1, 0)
    return float(ordered[cut]), float(ordered[ordered.size - 1 - cut])


def _best_level(free: Array, measured: Array) -> float:
    """Return the level h with the least sum of |measured - max(free, h)|."""
    levels = np.linspace(measured.min(), np.median(measured), CANDIDATES)
    costs = [float(np.sum(np.abs(measured - np.maximum(free, level)))) for level in levels]
    return float(levels[int(np.argmin(costs))])


def _excursions(flags: Flags, motion: Integers) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for begin, end in runs(flags):
        cuts = [begin, *(begin + 1 + np.flatnonzero(np.diff(motion[begin:end]))), end]
        found += [(int(b), int(e)) for b, e in pairwise(cuts)]
    return found


def _is_stopped(free: Array, measured: Array, value: float, sigma: float) -> bool:
    """Return whether an excursion goes deep enough, and the measured value does not follow."""
    if value - free.min() < DEPTH * sigma:
        return False
    is_sure = free < value - BEYOND * sigma
    if np.median((measured - free)[is_sure]) < BEYOND * sigma:
        return False
    return free.size < 2 or float(np.cov(free, measured)[0, 1]) < MAX_SLOPE * float(np.var(free, ddof=1))
