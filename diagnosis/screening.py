"""Rank effects by the share of the residual that they would explain, from a few simulations without a fit.

Each effect is simulated at several sizes: the derivative at size 0 says nothing of a velocity limit. Its
change, cleared of what the base parameters can do, is held against the residual motion by motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import f as fisher

from diagnosis.arrays import Array, Integers
from diagnosis.effects.effect import Effect
from diagnosis.fit import Fit, Union

FACTORS: Final = (0.3, 1.0, 3.0)
"""Sizes at which an effect is tried, over its typical size: half a decade to each side."""
DRAWS: Final = 2000
"""Random signs of the null distribution: its 5 % quantile is good to half a percent."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Sizes at which an effect is simulated, and the columns that they stand for."""

    effect: Effect
    points: tuple[Array, ...]
    """One size vector of the union for each direction, (n_sizes,) each."""


@dataclass(frozen=True, slots=True)
class Score:
    """Share of a residual that an effect explains."""

    effect: Effect
    start: Array
    """Sizes of the union from which a fit should begin, (n_sizes,)."""
    gain: float
    """Share of the weighted sum of squares that it removes."""
    by_motion: Array
    """Products of residual and change, (n_motions,): their sum is 0 if the effect is absent."""
    p: float
    """Probability of so good a score without the effect, by `wald_p`."""


def list_trials(union: Union, effect: Effect, at: Array) -> list[Trial]:
    """List the sizes at which an effect is tried.

    Args:
        union: Effects, and the columns of their sizes.
        effect: The effect.
        at: Sizes of the present model, (n_sizes,), in their own units.

    Returns:
        Trials with one direction for each size of the effect, for each factor and sign.
    """
    columns = union.columns([effect])
    trials = []
    for factor in FACTORS:
        for sign in (1.0, -1.0):
            points = []
            for column, size in zip(columns, effect.sizes, strict=True):
                point = at.copy()
                point[column] = np.clip(sign * factor * size.typical, size.low, size.high)
                points.append(point)
            if effect.has_shape:  # the other sizes say nothing while the first is 0
                points[0][columns[1:]] = [size.typical for size in effect.sizes[1:]]
                points = points[:1]
            if any(np.any(point != at) for point in points):
                trials.append(Trial(effect, tuple(points)))
    return trials


@dataclass(frozen=True, slots=True)
class Whitened:
    """Residuals with the weights of a robust loss, cleared of what the free sizes of their joint can do."""

    rows: Integers
    residual: Array
    """(n_rows,)."""
    motion: Integers
    parts: tuple[tuple[slice, Array, Array], ...]
    """For each joint: its rows, their weights (n,), an orthonormal basis of its base changes (n, p)."""

    def clear(self, change: Array) -> Array:
        """Weight a change of the residuals and clear it like the residuals.

        Args:
            change: (n_rows, n_points), in the unit of the model.

        Returns:
            (n_rows, n_points), without a unit.
        """
        cleared = np.empty_like(change)
        for rows, weight, basis in self.parts:
            part = np.where(np.isfinite(change[rows]), change[rows], 0.0) * weight[:, None]
            cleared[rows] = part - basis @ (basis.T @ part)
        return cleared


def whiten(fits: Sequence[Fit], motion_of: Integers, scales: Sequence[float]) -> Whitened:
    """Weight the residuals of some joints and clear them of what their free sizes can do.

    Args:
        fits: Present model of each joint.
        motion_of: Motion of each residual of the model, (n,), index.
        scales: Scale of the residuals of each joint, in their unit.

    Returns:
        The whitened residuals.
    """
    parts, residuals, begin = [], [], 0
    for fit, scale in zip(fits, scales, strict=True):
        weight = (1.0 + (fit.residuals / scale) ** 2) ** -0.25 / scale
        basis, _ = np.linalg.qr(fit.jacobian * weight[:, None])
        residual = fit.residuals * weight
        residuals.append(residual - basis @ (basis.T @ residual))
        parts.append((slice(begin, begin + len(residual)), weight, basis))
        begin += len(residual)
    rows = np.concatenate([fit.rows for fit in fits])
    return Whitened(rows, np.concatenate(residuals), motion_of[rows], tuple(parts))


def score_trial(white: Whitened, n_motions: int, trial: Trial, change: Array, at: Array) -> Score:
    """Hold the change that an effect makes against the residual of the present model.

    Args:
        white: Residuals of the present model.
        n_motions: Number of motions.
        trial: The trial.
        change: Change of the residuals at each point, (n_rows, n_points), in the unit of the fit.
        at: Sizes of the present model, (n_sizes,), in their own units.

    Returns:
        The score; with several points, the start is their best linear combination.
    """
    cleared = white.clear(change)
    energy = float(white.residual @ white.residual)
    solution, *_ = np.linalg.lstsq(cleared, -white.residual, rcond=1e-8)
    if len(trial.points) == 1 and solution[0] <= 0.0:
        solution = np.zeros(1)  # the trial of the other sign stands for it
    direction = cleared @ solution
    gain = 1.0 - float(np.sum((white.residual + direction) ** 2)) / energy if energy > 0.0 else 0.0
    # each product over the size of the residuals of its motion: one wild motion does not decide
    products = np.bincount(white.motion, weights=direction * white.residual, minlength=n_motions)
    sizes = np.sqrt(np.bincount(white.motion, weights=white.residual**2, minlength=n_motions))
    by_motion = -products / np.where(sizes > 0.0, sizes, 1.0)
    left = np.bincount(white.motion, weights=direction * (white.residual + direction), minlength=n_motions)
    # motions without this joint are no clusters
    p = wald_p(direction, left[np.unique(white.motion)].astype(np.float64), len(trial.points))
    start = trial.points[0]
    if len(trial.points) > 1:
        start = at + (np.array(trial.points) - at).T @ solution
    return Score(trial.effect, start, gain, by_motion, p)


def wald_p(direction: Array, left: Array, n_sizes: int) -> float:
    """Test whether the sizes of an effect are 0, with motions as clusters.

    The error of a size comes from the residuals that the effect leaves, so that an effect of different
    strength in different motions does not hide itself. The statistic is F with n_sizes and
    n_motions - n_sizes degrees of freedom.

    Args:
        direction: Change of the residuals by the effect at its best sizes, (n_rows,), without a unit.
        left: Products of that change with what it leaves, (n_motions,), without a unit.
        n_sizes: Number of sizes.

    Returns:
        Probability of the statistic, or a larger one, if the sizes are 0.
    """
    n = len(left)
    strength, scatter = float(direction @ direction), float(np.sum(left**2)) * n / max(n - 1, 1)
    if n <= n_sizes or strength == 0.0:
        return 1.0
    ratio = strength**2 / max(scatter, 1e-300) / n_sizes * (n - n_sizes) / (n - 1)
    return float(fisher.sf(ratio, n_sizes, n - n_sizes))


def family_wise_p(scores: list[Score], seed: int) -> Array:
    """Return the probability of each score, or a better one of any effect, if no effect is present.

    Two tests, each of all hypotheses together; the smaller probability counts twice. In the first, the signs
    of all products of a motion are flipped together: without an effect either sign is as likely. With few
    motions it cannot reject anything. The second is the Wald test of each effect, times their number.

    Args:
        scores: Scores of all effects that compete.
        seed: Seed of the signs.

    Returns:
        Probabilities, (n_scores,).
    """
    if not scores:
        return np.empty(0)
    table = np.array([score.by_motion for score in scores])
    size = np.sqrt(np.sum(table**2, axis=1))
    table = table / np.where(size > 0, size, 1.0)[:, None]
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(DRAWS, table.shape[1]))
    null = np.max(np.abs(signs @ table.T), axis=1)
    seen = np.abs(table.sum(axis=1))
    flipped = (np.sum(null[None, :] >= seen[:, None] - 1e-12, axis=1) + 1.0) / (DRAWS + 1.0)
    by_wald = np.array([score.p for score in scores]) * len(scores)
    both: Array = np.minimum(2.0 * np.minimum(flipped, by_wald), 1.0)
    return both
