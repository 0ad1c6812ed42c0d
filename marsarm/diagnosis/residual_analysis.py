"""Residual map and lack-of-fit test: is there structure that no model explains, and on what does it depend?

For the model y = N v + S a + e with A = [N S], the fit leaves M y, which has the covariance M:

    M = I - A (A'A + P)^-1 A'

For directions Q, the projection Q'M y is tested by a chi-square with covariance Q'M Q. The directions are a
constant and the conditions, in every channel and each of its regimes. The energy of the channel in that
regime is a second test. A last test takes all directions of all channels together.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.detectability import KINDS_OF_TEST
from marsarm.diagnosis.linear_fit import LinearFit, whitened_residual
from marsarm.diagnosis.normal_equations import NormalEquations
from marsarm.diagnosis.problem import INTERVAL_QUANTILES, FeatureLayout, Ints
from simgap import chi_square_log_p
from simgap.selection.chance import FALSE_ALARM

INTERVAL_DRAWS: Final = 400
"""Number of bootstrap draws for an interval."""
MIN_DIRECTION_SHARE: Final = 1e-6
"""Directions below this share of the largest are not tested."""
MIN_GROUP_FEATURES: Final = 4
"""Least number of features in a group."""


@dataclass(frozen=True, slots=True)
class ResidualCell:
    """Residual of one channel at one place in one regime."""

    channel: str
    place: str
    regime: str
    features: int
    ratio: float
    """Root mean square of the residual over its noise floor: 1 if there is only noise."""
    least: float
    most: float
    """Upper end of the 90 % interval by a bootstrap over blocks; NaN if there is one block."""


def map_residual(layout: FeatureLayout, residual: Array, seed: int) -> tuple[ResidualCell, ...]:
    """Compute the root mean square of the residual by channel, place and regime.

    Args:
        layout: Description of the m features.
        residual: Residual in units of the noise floor, shape (m,).
        seed: Seed of the bootstrap.

    Returns:
        Cells, largest ratio first.
    """
    rng = np.random.default_rng(seed)
    count = len(layout.blocks)
    weight = rng.multinomial(count, np.full(count, 1.0 / count), size=INTERVAL_DRAWS).astype(float)
    result = []
    of = np.stack([layout.channel, layout.place, layout.regime])
    for channel, place, regime in np.unique(of, axis=1).T:
        rows = np.flatnonzero(np.all(of == [[channel], [place], [regime]], axis=0))
        n = np.bincount(layout.block[rows], minlength=count)
        square = np.bincount(layout.block[rows], residual[rows] ** 2, minlength=count)
        least, most = _interval(weight @ square, weight @ n) if np.count_nonzero(n) > 1 else (np.nan, np.nan)
        result.append(ResidualCell(
            layout.channels[channel], layout.places[place], layout.regimes[regime], rows.size,
            float(np.sqrt(square.sum() / n.sum())), least, most,
        ))  # fmt: skip
    return tuple(sorted(result, key=lambda cell: -cell.ratio))


def _interval(square: Array, n: Array) -> tuple[float, float]:
    """Return the interval of drawn root mean squares."""
    ratios = np.sqrt(square[n > 0.0] / n[n > 0.0])
    least, most = np.quantile(ratios, INTERVAL_QUANTILES)
    return float(least), float(most)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureGroup:
    """Features that are tested together for structure."""

    channel: int
    regime: int | None
    """Index of the regime; None for all regimes together."""
    rows: Ints
    Q: Array
    """Orthonormal directions, shape (n, d)."""
    AQ: Array
    """Projected columns A'Q, shape (q + k, d)."""


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Result of the lack-of-fit test of one group."""

    neg_log10_p: float
    """-log10 of its probability if the model is right."""
    channel: str
    place: str
    regime: str
    """Regime, or "all"."""
    depends_on: str
    """Condition with the strongest dependence. "nothing" means an offset, "noise" energy without a direction,
    "several" all groups together."""


def group_features(equations: NormalEquations) -> tuple[FeatureGroup, ...]:
    """Form the groups of the lack-of-fit test, before data."""
    layout = equations.layout
    result = []
    for channel in np.unique(layout.channel):
        mine = layout.channel == channel
        regimes = np.unique(layout.regime[mine])
        for regime in [None, *(int(one) for one in regimes)] if regimes.size > 1 else [None]:
            rows = np.flatnonzero(mine if regime is None else mine & (layout.regime == regime))
            if rows.size >= MIN_GROUP_FEATURES:
                U, s, _ = np.linalg.svd(_directions(layout, rows), full_matrices=False)
                Q = U[:, s > MIN_DIRECTION_SHARE * s[0]]
                result.append(FeatureGroup(int(channel), regime, rows, Q, equations.A[rows].T @ Q))
    return tuple(result)


def find_lack_of_fit(
    equations: NormalEquations, groups: tuple[FeatureGroup, ...], fit: LinearFit, y: Array
) -> tuple[LackOfFit, ...]:
    """Test every group, and all groups together, for structure.

    Args:
        equations: Normal equations of the campaign.
        fit: Linear fit of the case.
        y: Whitened features, shape (m,).

    Returns:
        Results, most significant first; the greater -log10 p of both tests counts.
    """
    rest = whitened_residual(equations, fit, y)
    total, freedom, found = 0.0, 0, []
    for group in groups:
        statistic, d = _chi_square(group, fit, rest)
        whole = group.regime is None
        total, freedom = total + statistic * whole, freedom + d * whole
        energy, n = _energy(equations, group, fit, rest)
        of_direction, of_energy = _neg_log10_p(statistic, d), _neg_log10_p(energy, n)
        found.append((max(of_direction, of_energy), of_direction >= of_energy, group))
    together = _neg_log10_p(total, max(freedom, 1))
    result = [
        _describe(equations.layout, group, rest, larger, by_direction)
        for larger, by_direction, group in found
    ]
    everywhere = LackOfFit(together, "all", "all", "all", "several")
    return tuple(sorted([*result, everywhere], key=lambda one: -one.neg_log10_p))


def lack_of_fit_limit(groups: tuple[FeatureGroup, ...]) -> float:
    """Return the -log10 p from which on structure counts.

    All tests together have their part of the probability of a false alarm (Bonferroni).
    """
    tests = 2 * len(groups) + 1
    return float(-np.log10(FALSE_ALARM / KINDS_OF_TEST / tests))


def _neg_log10_p(statistic: float, freedom: float) -> float:
    return -chi_square_log_p(statistic, freedom) / float(np.log(10.0))


def _directions(layout: FeatureLayout, rows: Ints) -> Array:
    """Return a constant and the centred conditions, each of norm 1 or 0, (n, 1 + c)."""
    centred = layout.condition[rows] - layout.condition[rows].mean(axis=0)
    all_of = np.column_stack([np.ones(rows.size), centred])
    norm = np.linalg.norm(all_of, axis=0)
    small = norm <= MIN_DIRECTION_SHARE * np.maximum(np.linalg.norm(layout.condition, axis=0), 1.0).max()
    return np.asarray(all_of * np.where(small, 0.0, 1.0 / np.where(small, 1.0, norm)))


def _chi_square(group: FeatureGroup, fit: LinearFit, rest: Array) -> tuple[float, int]:
    """Return statistic and degrees of freedom of the directions of a group."""
    AQ = group.AQ[fit.active]
    s, V = np.linalg.eigh(np.eye(group.Q.shape[1]) - AQ.T @ fit.covariance @ AQ)
    kept = s > MIN_DIRECTION_SHARE
    along = V[:, kept].T @ (group.Q.T @ rest[group.rows])
    return float(np.sum(along**2 / s[kept])), int(kept.sum())


def _energy(
    equations: NormalEquations, group: FeatureGroup, fit: LinearFit, rest: Array
) -> tuple[float, float]:
    """Return the sum of squares in a group, and its expectation."""
    A = equations.A[np.ix_(group.rows, fit.active)]
    expected = group.rows.size - float(np.sum((A @ fit.covariance) * A))
    return float(np.sum(rest[group.rows] ** 2)), max(expected, 1.0)


def _describe(
    layout: FeatureLayout, group: FeatureGroup, rest: Array, neg_log10_p: float, by_direction: bool
) -> LackOfFit:
    """Return the test result with its names."""
    along = np.abs(_directions(layout, group.rows).T @ rest[group.rows])
    names = ("nothing", *layout.conditions)
    places = np.bincount(layout.place[group.rows])
    return LackOfFit(
        neg_log10_p, layout.channels[group.channel], layout.places[int(np.argmax(places))],
        "all" if group.regime is None else layout.regimes[group.regime],
        names[int(np.argmax(along))] if by_direction else "noise",
    )  # fmt: skip
