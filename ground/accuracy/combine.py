"""Many errors as one bound: the paper's combinations, equations 10 to 13, and one from their moments."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from ground.accuracy.sources import CUMULANTS, Distribution

MIN_SKEWNESS: Final = 0.05
"""Less is as good as none."""
MAX_SKEWNESS: Final = np.sqrt(8.0)
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
            skewness = np.where(self.variance > 0, self.third / self.variance**1.5, MAX_SKEWNESS)
        return np.asarray(8 / np.clip(skewness, MIN_SKEWNESS, MAX_SKEWNESS) ** 2)

    def quantile(self, coverage: float) -> Array:
        """The length (n,) that the error stays within, with this probability."""
        freedom = self._freedom
        normed = (chi2.ppf(coverage, freedom) - freedom) / np.sqrt(2 * freedom)
        return np.asarray(np.sqrt(np.maximum(self.mean + normed * np.sqrt(self.variance), 0.0)))

    def probability_within(self, length: float) -> Array:
        """With which probability (n,) the error is no longer than this."""
        freedom, sigma = self._freedom, np.sqrt(self.variance)
        apart = length**2 - self.mean
        normed = np.divide(apart, sigma, out=np.where(apart < 0, -np.inf, np.inf), where=sigma > 0)
        return np.asarray(chi2.cdf(freedom + np.sqrt(2 * freedom) * normed, freedom))


def squared_length(errors: Sequence[tuple[Array, Distribution]], known: Array | None = None) -> SquaredLength:
    """Of a known error (m, n) and independent ones (m, k, n) at their magnitudes, k of a spread at a time."""
    m, _, n = errors[0][0].shape
    c = np.zeros((m, n)) if known is None else known
    S = np.zeros((m, m, n))
    for u, spread in errors:
        S += CUMULANTS[spread][0] * np.einsum("ikn,jkn->ijn", u, u)
    S2 = np.einsum("ijn,jkn->ikn", S, S)
    mean = np.einsum("iin->n", S) + np.einsum("in,in->n", c, c)
    variance = 2 * np.einsum("iin->n", S2) + 4 * np.einsum("in,ijn,jn->n", c, S, c)
    third = 8 * np.einsum("ijn,jin->n", S2, S) + 24 * np.einsum("in,ijn,jn->n", c, S2, c)
    for u, spread in errors:
        _, k4, k6 = CUMULANTS[spread]
        if k4:
            square = np.einsum("ikn,ikn->kn", u, u)
            variance += k4 * np.einsum("kn,kn->n", square, square)
            along = np.einsum("ikn,ijn,jkn->kn", u, S, u) + np.einsum("in,ikn->kn", c, u) ** 2
            third += 12 * k4 * np.einsum("kn,kn->n", square, along) + k6 * (square**3).sum(axis=0)
    return SquaredLength(mean, np.maximum(variance, 0.0), third)


def pooled_quantile(lengths: Sequence[SquaredLength], coverage: float) -> float:
    """What this share of the errors at all poses stays within, one pose as likely as another."""
    most = max(float(length.quantile(coverage).max()) for length in lengths)
    if most == 0:
        return 0.0

    def beyond(length: float) -> float:
        return coverage - float(np.concatenate([one.probability_within(length) for one in lengths]).mean())

    return float(brentq(beyond, 0.0, 2 * most, xtol=1e-9))


TOTAL, LATERAL, NORMAL, AXIAL = [3, 4, 5], [4, 5], [3], [1, 2]
"""Which components of a screw in tool axes make up the error: of position, across and along the approach, and
of the direction of the approach."""
PARTS: Final = (TOTAL, LATERAL, NORMAL, AXIAL)


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """What the errors at the tool stay within, pose by pose, (n,) each."""

    total_m: Array
    lateral_m: Array
    normal_m: Array
    axial_rad: Array


def bounds(u: Array) -> Bounds:
    """The bounds that follow from components (6, n), each plus or minus."""
    return Bounds(*(np.linalg.norm(u[part], axis=0) for part in PARTS))


def worst_case(u: Array) -> Array:
    """All errors (sources, 6, 7, n) added: components (6, n). Paper equation 10."""
    return np.asarray(u.sum(axis=(0, 2)))


def root_sum_square(u: Array) -> Array:
    """As if all were independent. Paper equation 11."""
    return np.asarray(np.sqrt((u**2).sum(axis=(0, 2))))


def paper_rule(u: Array, at_limit: Flags) -> Array:
    """Frames added source by source; those at their limits added, the others root-sum-squared.

    Paper equations 12 and 13, by the text: the root that is printed covers the added ones too.
    """
    source = u.sum(axis=2)
    return np.asarray(source[at_limit].sum(axis=0) + np.sqrt((source[~at_limit] ** 2).sum(axis=0)))


def shares(u: Array, at_limit: Flags) -> Array:
    """What each source at each frame makes up of the total by the paper's rule, (sources, 7, n) in metres.

    An added source makes up its own components; one under the root its square over the root. Components make
    up the length of the error by their square over it. So the shares add up to the total.
    """
    source = u.sum(axis=2)
    root = np.sqrt((source[~at_limit] ** 2).sum(axis=0))
    weight = np.ones_like(source)
    weight[~at_limit] = _divide(source[~at_limit], root)
    total = paper_rule(u, at_limit)[TOTAL]
    along = _divide(total, np.linalg.norm(total, axis=0))
    return np.asarray(np.einsum("cn,sc...n,scn->s...n", along, u[:, TOTAL], weight[:, TOTAL]))


def moments_rule(lengths: Sequence[SquaredLength], worst: Bounds, coverage: float) -> Bounds:
    """What the errors stay within, with this probability: PARTS in order, at most the worst case."""
    within = [length.quantile(coverage) for length in lengths]
    most = (getattr(worst, field.name) for field in fields(Bounds))
    return Bounds(*(np.minimum(a, b) for a, b in zip(within, most, strict=True)))


def _divide(a: Array, b: Array) -> Array:
    """A / b, or nothing where b is nothing."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0)
