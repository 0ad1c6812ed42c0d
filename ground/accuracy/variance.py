"""How far arms differ from one another, and one arm from itself: a one-way analysis of variance.

An error is mean + a of its arm + e of its own; a and e are random vectors. With K arms and n errors of each,
M_a = n sum |arm's mean - mean|^2 / (K - 1) and M_e = sum |error - arm's mean|^2 / (K (n - 1)) have the
expectations n V_a + V_e and V_e, where V is the sum of a vector's variances. Accuracy is about nought: the
mean counts. Upper bounds are those of Graybill and Wang (1980) for a sum of mean squares, with the degrees of
freedom that a vector has by its covariance (Box 1954).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2, norm

from fsw.kinematics.transforms import Array

SIGMAS: Final = 3.0
CONFIDENCE: Final = 0.95
NORMAL: Final = float(norm.ppf(CONFIDENCE))


@dataclass(frozen=True, slots=True)
class ThreeSigma:
    """Three sigma of an error's length, and what it is at most, with 95 % confidence."""

    estimate: float
    upper: float


@dataclass(frozen=True, slots=True)
class Spreads:
    """What arms are held to."""

    accuracy: ThreeSigma
    """Of any arm, about nought."""
    repeatability: ThreeSigma
    """Of one arm, about its mean."""


def spreads(error: Array) -> Spreads:
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
    mean_above = 2 * NORMAL * float(np.sqrt(mean @ between.S @ mean / (arms * each)))
    above = np.sqrt(mean_above**2 + sum((share * part.above()) ** 2 for share, part in parts))
    return Spreads(
        ThreeSigma(_sigmas(about_nought + total), _sigmas(about_nought + total + above)),
        ThreeSigma(_sigmas(within.value), _sigmas(within.value + within.above())),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _MeanSquare:
    S: Array
    value: float
    freedom: float

    @staticmethod
    def of(deviations: Array, freedom: int) -> "_MeanSquare":
        """Of vectors (components, n) that are left with so many degrees of freedom."""
        S = deviations @ deviations.T / freedom
        total, square = float(np.trace(S)), float(np.trace(S @ S))
        return _MeanSquare(S, total, freedom * (total**2 / square if square > 0 else 1.0))

    def above(self) -> float:
        """From the mean square to the upper bound of what it estimates."""
        return self.value * (self.freedom / float(chi2.ppf(1 - CONFIDENCE, self.freedom)) - 1)


def _sigmas(variance: float) -> float:
    return SIGMAS * float(np.sqrt(variance))
