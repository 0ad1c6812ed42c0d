"""Combination of errors into one bound: paper equations 10 to 13, and a rule from moments."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from marsarm.accuracy.sources import CUMULANTS, Distribution

MIN_SKEWNESS: Final = 0.05
"""Smallest skewness; below it, the distribution counts as symmetric."""
MAX_SKEWNESS: Final = np.sqrt(8.0)
"""Skewness of the square of one normal variable, the largest of a sum of such squares."""
TOTAL, LATERAL, NORMAL, AXIAL = [3, 4, 5], [4, 5], [3], [1, 2]
"""Components of a screw in tool axes that make up each error.

Total, lateral and normal are errors of position; axial is the error of the approach direction.
"""
COVERAGE: Final = 0.9973
"""Three sigma of a normal error; also the share of poses whose bound is within the reported value."""
PARTS: Final = (TOTAL, LATERAL, NORMAL, AXIAL)


@dataclass(frozen=True, slots=True, eq=False)
class SquaredLength:
    """First three cumulants of the squared length of an error at each pose, shape (n,) each."""

    mean: Array
    variance: Array
    third: Array

    @property
    def _degrees_of_freedom(self) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            skewness = np.where(self.variance > 0, self.third / self.variance**1.5, MAX_SKEWNESS)
        return np.asarray(8 / np.clip(skewness, MIN_SKEWNESS, MAX_SKEWNESS) ** 2)

    def quantile(self, coverage: float) -> Array:
        """Compute the error length that is not exceeded with this probability.

        A shifted and scaled chi-square distribution matches the three cumulants.

        Args:
            coverage: Probability.

        Returns:
            Lengths, shape (n,).
        """
        degrees_of_freedom = self._degrees_of_freedom
        normed = (chi2.ppf(coverage, degrees_of_freedom) - degrees_of_freedom) / np.sqrt(
            2 * degrees_of_freedom
        )
        return np.asarray(np.sqrt(np.maximum(self.mean + normed * np.sqrt(self.variance), 0.0)))

    def probability_within(self, length: float) -> Array:
        """Compute the probability, shape (n,), that the error is not longer than this."""
        degrees_of_freedom, sigma = self._degrees_of_freedom, np.sqrt(self.variance)
        excess = length**2 - self.mean
        normed = np.divide(excess, sigma, out=np.where(excess < 0, -np.inf, np.inf), where=sigma > 0)
        return np.asarray(
            chi2.cdf(degrees_of_freedom + np.sqrt(2 * degrees_of_freedom) * normed, degrees_of_freedom)
        )


def squared_length(errors: Sequence[tuple[Array, Distribution]], known: Array | None = None) -> SquaredLength:
    """Compute the cumulants of squared error lengths.

    Args:
        errors: Independent errors at their magnitudes, shape (m, k, n), with their distributions.
        known: Known error to add, shape (m, n); zero by default.

    Returns:
        The cumulants.
    """
    m, _, n = errors[0][0].shape
    c = np.zeros((m, n)) if known is None else known
    S = np.zeros((m, m, n))
    for u, distribution in errors:
        S += CUMULANTS[distribution][0] * np.einsum("ikn,jkn->ijn", u, u)
    S2 = np.einsum("ijn,jkn->ikn", S, S)
    mean = np.einsum("iin->n", S) + np.einsum("in,in->n", c, c)
    variance = 2 * np.einsum("iin->n", S2) + 4 * np.einsum("in,ijn,jn->n", c, S, c)
    third = 8 * np.einsum("ijn,jin->n", S2, S) + 24 * np.einsum("in,ijn,jn->n", c, S2, c)
    for u, distribution in errors:
        _, k4, k6 = CUMULANTS[distribution]
        if k4:
            square = np.einsum("ikn,ikn->kn", u, u)
            variance += k4 * np.einsum("kn,kn->n", square, square)
            along = np.einsum("ikn,ijn,jkn->kn", u, S, u) + np.einsum("in,ikn->kn", c, u) ** 2
            third += 12 * k4 * np.einsum("kn,kn->n", square, along) + k6 * (square**3).sum(axis=0)
    return SquaredLength(mean, np.maximum(variance, 0.0), third)


def pooled_quantile(lengths: Sequence[SquaredLength], coverage: float) -> float:
    """Compute the error length that this share of the errors at all poses does not exceed."""
    most = max(float(length.quantile(coverage).max()) for length in lengths)
    if most == 0:
        return 0.0

    def beyond(length: float) -> float:
        return coverage - float(np.concatenate([one.probability_within(length) for one in lengths]).mean())

    return float(brentq(beyond, 0.0, 2 * most, xtol=1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Bounds of the tool errors at each pose, shape (n,) each."""

    total_m: Array
    lateral_m: Array
    normal_m: Array
    axial_rad: Array


def bounds(u: Array) -> Bounds:
    """Compute the bounds from components.

    Args:
        u: Absolute errors [rad, m], shape (6, n).

    Returns:
        Bounds of each part of the error.
    """
    return Bounds(*(np.linalg.norm(u[part], axis=0) for part in PARTS))


def worst_case(u: Array) -> Array:
    """Add all errors (paper equation 10).

    Args:
        u: Absolute errors [rad, m], shape (sources, 6, 7, n).

    Returns:
        Components [rad, m], shape (6, n).
    """
    return np.asarray(u.sum(axis=(0, 2)))


def root_sum_square(u: Array) -> Array:
    """Combine all errors as independent (paper equation 11).

    Args:
        u: Absolute errors [rad, m], shape (sources, 6, 7, n).

    Returns:
        Components [rad, m], shape (6, n).
    """
    return np.asarray(np.sqrt((u**2).sum(axis=(0, 2))))


def paper_rule(u: Array, at_limit: Flags) -> Array:
    """Combine errors by the paper's rule (equations 12 and 13).

    Frames of a source are added. Sources at their limits are added, the others combined as root sum square.
    This follows the text of the paper: its printed root covers the added sources too.

    Args:
        u: Absolute errors [rad, m], shape (sources, 6, 7, n).
        at_limit: Flags of sources at their limits, shape (sources,).

    Returns:
        Components [rad, m], shape (6, n).
    """
    source = u.sum(axis=2)
    return np.asarray(source[at_limit].sum(axis=0) + np.sqrt((source[~at_limit] ** 2).sum(axis=0)))


def shares(u: Array, at_limit: Flags) -> Array:
    """Divide the total error by the paper's rule among sources and frames.

    An added source has the weight one; a source under the root has its own value over the root. A component
    has the weight of its value over the length of the error. So the shares add up to the total.

    Args:
        u: Absolute errors [rad, m], shape (sources, 6, 7, n).
        at_limit: Flags of sources at their limits, shape (sources,).

    Returns:
        Shares [m], shape (sources, 7, n).
    """
    source = u.sum(axis=2)
    root = np.sqrt((source[~at_limit] ** 2).sum(axis=0))
    weight = np.ones_like(source)
    weight[~at_limit] = _divide(source[~at_limit], root)
    total = paper_rule(u, at_limit)[TOTAL]
    along = _divide(total, np.linalg.norm(total, axis=0))
    return np.asarray(np.einsum("cn,sc...n,scn->s...n", along, u[:, TOTAL], weight[:, TOTAL]))


def moments_rule(lengths: Sequence[SquaredLength], worst: Bounds, coverage: float) -> Bounds:
    """Compute the bounds that hold with this probability, at most the worst case.

    Args:
        lengths: Distributions of squared lengths in the order of PARTS.
        worst: Worst-case bounds.
        coverage: Probability.

    Returns:
        The bounds.
    """
    within = [length.quantile(coverage) for length in lengths]
    most = (getattr(worst, field.name) for field in fields(Bounds))
    return Bounds(*(np.minimum(a, b) for a, b in zip(within, most, strict=True)))


def _divide(a: Array, b: Array) -> Array:
    """Compute a / b, and 0 where b is 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0)
