"""How long a sum of independent errors is, from the moments of each: our own rule.

The squared length Q of u = sum of u_k e_k, with errors e_k of cumulants k2, k4, k6 and no odd ones, has with
S = sum of k2 u_k u_k' the cumulants

    tr S,    2 tr S^2 + sum k4 |u_k|^4,    8 tr S^3 + 12 sum k4 |u_k|^2 u_k' S u_k + sum k6 |u_k|^6

For normal errors only the first terms are left. A scaled and shifted chi-square with the same three gives
quantiles (Hall, Buckley and Eagleson; Buckley and Eagleson 1988).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from fsw.kinematics.transforms import Array
from ground.accuracy.sources import CUMULANTS_OF, Spread

LEAST_SKEWED: Final = 0.05
"""Less is as good as none."""
MOST_SKEWED: Final = np.sqrt(8.0)
"""A sum of squares of normals is, if it is one square."""


@dataclass(frozen=True, slots=True, eq=False)
class SquaredLength:
    """Of an error, pose by pose: its first three cumulants, (n,) each."""

    mean: Array
    variance: Array
    third: Array

    @property
    def _freedom(self) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            skewness = np.where(self.variance > 0, self.third / self.variance**1.5, MOST_SKEWED)
        return np.asarray(8 / np.clip(skewness, LEAST_SKEWED, MOST_SKEWED) ** 2)

    def quantile(self, coverage: float) -> Array:
        """The length (n,) that the error stays within, with this probability."""
        freedom = self._freedom
        normed = (chi2.ppf(coverage, freedom) - freedom) / np.sqrt(2 * freedom)
        return np.asarray(np.sqrt(np.maximum(self.mean + normed * np.sqrt(self.variance), 0.0)))

    def within(self, length: float) -> Array:
        """With which probability (n,) the error is no longer than this."""
        freedom, sigma = self._freedom, np.sqrt(self.variance)
        apart = length**2 - self.mean
        normed = np.divide(apart, sigma, out=np.where(apart < 0, -np.inf, np.inf), where=sigma > 0)
        return np.asarray(chi2.cdf(freedom + np.sqrt(2 * freedom) * normed, freedom))


def squared_length(errors: Sequence[tuple[Array, Spread]]) -> SquaredLength:
    """Of the sum of independent errors (m, k, n) at their magnitudes, k of a spread at a time."""
    m, _, n = errors[0][0].shape
    S = np.zeros((m, m, n))
    for u, spread in errors:
        S += CUMULANTS_OF[spread][0] * np.einsum("ikn,jkn->ijn", u, u)
    S2 = np.einsum("ijn,jkn->ikn", S, S)
    mean = np.einsum("iin->n", S)
    variance = 2 * np.einsum("iin->n", S2)
    third = 8 * np.einsum("ijn,jin->n", S2, S)
    for u, spread in errors:
        _, k4, k6 = CUMULANTS_OF[spread]
        if k4:
            square = np.einsum("ikn,ikn->kn", u, u)
            variance += k4 * np.einsum("kn,kn->n", square, square)
            along = np.einsum("ikn,ijn,jkn->kn", u, S, u)
            third += 12 * k4 * np.einsum("kn,kn->n", square, along) + k6 * (square**3).sum(axis=0)
    return SquaredLength(mean, np.maximum(variance, 0.0), third)


def pooled_quantile(lengths: Sequence[SquaredLength], coverage: float) -> float:
    """What this share of the errors at all poses stays within, one pose as likely as another."""
    most = max(float(length.quantile(coverage).max()) for length in lengths)
    if most == 0:
        return 0.0

    def beyond(length: float) -> float:
        return coverage - float(np.concatenate([one.within(length) for one in lengths]).mean())

    return float(brentq(beyond, 0.0, 2 * most, xtol=1e-9))
