"""Name what is fitted: a hypothesis frees a few sizes, and reads the residuals of one joint or of all.

Residuals are arrays (n,) in the unit of the model, scales (n_joints,) too; columns are indices, (n_sizes,).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers, Slopes
from simgap.effects.effect import Effect, Size
from simgap.residuals.residuals import ResidualModel
from simgap.selection.sharing import ALL_JOINTS

STEP: Final = 0.05
"""Finite-difference step over the typical size: more than one stick or slip changes, small beside it."""
SQUARES: Final = 100.0
"""Scale of the loss over the largest residual at which it is a sum of squares, to 1e-4."""


@dataclass(frozen=True)
class Union:
    """All effects that are fitted in a diagnosis, and the place of their sizes in one vector."""

    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        """Check that each effect has a key of its own, by which its sizes are found."""
        keys = [effect.key for effect in self.effects]
        assert len(set(keys)) == len(keys), f"effects come twice: {sorted(keys)}"

    @cached_property
    def sizes(self) -> tuple[Size, ...]:
        """Sizes of all effects, one after the other."""
        return tuple(size for effect in self.effects for size in effect.sizes)

    @cached_property
    def owner(self) -> Integers:
        """Index of the effect of each column, (n_sizes,)."""
        return np.repeat(np.arange(len(self.effects)), [len(effect.sizes) for effect in self.effects])

    def sizes_at(self, columns: Integers) -> list[Size]:
        """Return the sizes in these columns."""
        sizes = self.sizes
        return [sizes[c] for c in columns]

    def columns(self, effects: Sequence[Effect]) -> Integers:
        """Return the columns of the sizes of these effects, (n_sizes,) indices."""
        return np.concatenate([np.empty(0, np.int64), *(self._columns[effect.key] for effect in effects)])

    @cached_property
    def _columns(self) -> dict[str, Integers]:
        """Columns of the sizes of each effect, by its key."""
        starts = np.cumsum([0, *(len(effect.sizes) for effect in self.effects)])
        ranges = pairwise(starts)
        return {
            effect.key: np.arange(first, last, dtype=np.int64)
            for effect, (first, last) in zip(self.effects, ranges, strict=True)
        }


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Sizes that are free, where they start, and the residuals that they have to explain."""

    columns: Integers
    """Free columns of the union, (p,)."""
    start: Array
    """Sizes of the whole union, (n_sizes,)."""
    joint: int = ALL_JOINTS
    """Index of the joint whose residuals count."""
    jacobian: Slopes | None = None
    """Derivatives to begin with, (n_rows, p), from a fit that is near; NaN in columns that are not known."""
    other_starts: tuple[Array, ...] = ()
    """Further sizes, (n_sizes,) each, from which the fit begins if they explain more."""


@dataclass(frozen=True, slots=True)
class JointFit:
    """Hypothesis at its optimum."""

    sizes: Array
    """(n_sizes,)."""
    columns: Integers
    joint: int
    """Index of the joint, or ALL_JOINTS."""
    residuals: Array
    """Residuals of its joint, (n_rows,)."""
    rows: Integers
    """Their indices in the residual model."""
    jacobian: Slopes
    """Derivatives of the residuals by the free sizes, (n_rows, p)."""


def gather_residuals(fits: Sequence[JointFit], n_rows: int) -> Array:
    """Put the residuals of the joints in one array, (n_rows,), in the unit of the model."""
    together = np.zeros(n_rows)
    for fit in fits:
        together[fit.rows] = fit.residuals
    return together


def scale_residuals(model: ResidualModel, residuals: Array) -> Array:
    """Return a robust deviation for each joint, (n_joints,): 1.4826 times the median absolute residual.

    Known noise is normal, and its loss is a sum of squares: that of a scale which no residual comes near.
    """
    scales = np.ones(len(model.joints))
    if model.noise_std:
        return SQUARES * max(model.noise_std, float(np.max(np.abs(residuals), initial=0.0))) * scales
    for joint in range(len(model.joints)):
        chosen = np.abs(residuals[model.joint_of == joint])
        if len(chosen):
            scales[joint] = max(1.4826 * float(np.median(chosen)), 1e-9)
    return scales


def select_rows(model: ResidualModel, joint: int) -> Integers:
    """Return the rows of the residuals of a joint, or of ALL_JOINTS, (n_rows,) indices."""
    return np.arange(len(model.joint_of)) if joint == ALL_JOINTS else np.flatnonzero(model.joint_of == joint)
