"""Rank effects by the share of the residual that they would explain, from a few simulations without a fit.

Each effect is simulated at several sizes: the derivative at size 0 says nothing of a velocity limit. Its
change, cleared of what the base parameters can do, is held against the residual motion by motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Integers
from diagnosis.blocks import Blocks, cut_rows
from diagnosis.chance import can_flip, flip_basis, flips_p, wald_by_place, wald_p
from diagnosis.effects.effect import Effect
from diagnosis.fit import Fit, Union
from diagnosis.residuals import ResidualModel

FACTORS: Final = (0.3, 1.0, 3.0)
"""Sizes at which an effect is tried, over its typical size: half a decade to each side."""
ALIKE: Final = 0.99
"""Cosine above which two changes of the residuals count as one."""


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
    flips: tuple[Array, ...]
    """One basis for sign flips, by `flip_basis`, for each trial that differs from the others."""
    p: float
    """Probability of so good a score of any trial without the effect, by `wald_p`."""
    left: tuple[tuple[Integers, Array], ...] = ()
    """For each joint: rows of the residual model, and what the effect leaves there, without a unit; empty
    where motions are not cut into blocks."""


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
    time_s: Array
    """(n_rows,)."""
    whole: Integers
    """Motion before it was cut into blocks, (n_rows,)."""
    is_cut: bool
    """True if motions are blocks of a few whole ones."""
    parts: tuple[tuple[slice, Array, Array], ...]
    """For each joint: its rows, their weights (n,), an orthonormal basis of its base changes (n, p)."""

    @property
    def basis(self) -> Array:
        """Base changes of all joints, orthonormal, (n_rows, n_base)."""
        together = np.zeros((self.residual.size, sum(basis.shape[1] for *_, basis in self.parts)))
        first = 0
        for rows, _, basis in self.parts:
            together[rows, first : first + basis.shape[1]] = basis
            first += basis.shape[1]
        return together

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

    def clusters(self, left: Array) -> Integers:
        """Return the clusters of a Wald test.

        Motions are clusters. A log of few motions is cut by the memory of what the effect leaves: a misfit
        that the effect explains is no noise, and would make blocks so long that nothing could be rejected.

        Args:
            left: Residuals that the effect leaves, (n_rows,), without a unit.

        Returns:
            Cluster of each residual, (n_rows,).
        """
        if not self.is_cut:
            return self.motion
        return cut_rows(self.time_s, self.whole, [(rows, left[rows]) for rows, *_ in self.parts])


def whiten(fits: Sequence[Fit], model: ResidualModel, scales: Sequence[float]) -> Whitened:
    """Weight the residuals of some joints and clear them of what their free sizes can do.

    Args:
        fits: Present model of each joint.
        model: The residual model.
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
    is_cut = isinstance(model, Blocks)
    whole = model.parent_of if isinstance(model, Blocks) else model.motion_of
    return Whitened(
        rows,
        np.concatenate(residuals),
        model.motion_of[rows],
        model.time_s[rows],
        whole[rows],
        is_cut,
        tuple(parts),
    )


def score_effect(
    white: Whitened, n_motions: int, trials: Sequence[Trial], changes: Sequence[Array], at: Array
) -> Score:
    """Hold the changes that an effect makes against the residual of the present model.

    Args:
        white: Residuals of the present model.
        n_motions: Number of motions.
        trials: Trials of one effect.
        changes: For each trial the change of the residuals at its points, (n_rows, n_points), in the unit of
            the fit.
        at: Sizes of the present model, (n_sizes,), in their own units.

    Returns:
        The score of the best trial; with several points, the start is their best linear combination.
    """
    energy = float(white.residual @ white.residual)
    sizes = np.sqrt(np.bincount(white.motion, weights=white.residual**2, minlength=n_motions))
    best: tuple[float, Array, Array] | None = None
    seen: list[Array] = []
    flips: list[Array] = []
    for trial, change in zip(trials, changes, strict=True):
        cleared = white.clear(change)
        solution, *_ = np.linalg.lstsq(cleared, -white.residual, rcond=1e-8)
        tested = cleared @ solution
        if is_new(tested, seen):
            seen.append(tested / np.linalg.norm(tested))
            # each product over the size of the residuals of its motion: one wild motion does not decide
            products = sum_by_motion(white.motion, cleared * white.residual[:, None], n_motions)
            flips.append(flip_basis(products / np.where(sizes > 0.0, sizes, 1.0)[:, None]))
        if len(trial.points) == 1 and solution[0] <= 0.0:
            solution = np.zeros(1)  # the trial of the other sign stands for it
        left = float(np.sum((white.residual + cleared @ solution) ** 2))
        gain = 1.0 - left / energy if energy > 0.0 else 0.0
        if best is None or gain > best[0]:
            start = trial.points[0]
            if len(trial.points) > 1:
                start = at + (np.array(trial.points) - at).T @ solution
            best = (gain, start, cleared)
    assert best is not None, "an effect without a trial"
    gain, start, cleared = best
    if gain <= 0.0:
        return Score(trials[0].effect, start, gain, tuple(flips), 1.0)
    solution, *_ = np.linalg.lstsq(cleared, -white.residual, rcond=1e-8)
    rest = white.residual + cleared @ solution
    p = min(1.0, len(seen) * wald_p(white.basis, cleared, white.residual, white.clusters(rest)))
    kept = tuple((white.rows[rows], rest[rows]) for rows, *_ in white.parts) if white.is_cut else ()
    return Score(trials[0].effect, start, gain, tuple(flips), p, kept)


def is_new(change: Array, seen: Sequence[Array]) -> bool:
    """Return whether a change differs from others: tests of changes that are alike reject together.

    Args:
        change: (n_rows,), in any unit.
        seen: Others, (n_rows,) each, of length 1 and without a unit.

    Returns:
        True if its cosine with each of them is below ALIKE; False if there is no change.
    """
    length = float(np.linalg.norm(change))
    return length > 0.0 and all(abs(float(change @ one)) < ALIKE * length for one in seen)


def sum_by_motion(motion: Integers, values: Array, n_motions: int) -> Array:
    """Sum values over the rows of each motion.

    Args:
        motion: Motion of each row, (n_rows,), index.
        values: (n_rows, n_columns), in any unit.
        n_motions: Number of motions.

    Returns:
        (n_motions, n_columns), in the unit of the values.
    """
    return np.column_stack([np.bincount(motion, weights=one, minlength=n_motions) for one in values.T])


def family_wise_p(scores: Sequence[Score], n_whole: int, seed: int) -> Array:
    """Return the probability of each score, or a better one of any effect, if no effect is present.

    Two tests, each of all hypotheses together; the smaller probability counts twice. With few motions, sign
    flips cannot reject anything; blocks of a motion are not independent enough for them. Then the Wald test
    stands alone.

    Args:
        scores: Scores of all effects that compete.
        n_whole: Number of motions; 0 if they were cut into blocks.
        seed: Seed of the signs.

    Returns:
        Probabilities, (n_scores,).
    """
    if not scores:
        return np.empty(0)
    wald = wald_by_place(np.array([one.p for one in scores]), [one.effect.place for one in scores])
    if not can_flip(n_whole):
        return wald
    flipped = flips_p([one.flips for one in scores], seed)
    both: Array = np.minimum(2.0 * np.minimum(flipped, wald), 1.0)
    return both
