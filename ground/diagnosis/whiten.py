"""Features in units of their floor, independent of each other: what all fits are made in.

Within a block b, features share what is drawn anew there: their covariance is D (I + L L') D, with D the
floors and L (n_b, s) the sensitivities to what is drawn, times its sigma, over the floors. With L = U S V'
the symmetric root of the inverse is I - U (1 - 1 / sqrt(1 + S^2)) U', so that a feature mostly stays what it
was.
"""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.layout import Ints
from ground.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class BlockScatter:
    """What the features of one block share by chance."""

    rows: Ints
    """Its features, (n,)."""
    U: Array
    """Directions, (n, s)."""
    less: Array
    """By which share each of them is to be reduced, (s,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Makes the noise of the features independent and of variance 1."""

    sigma: Array
    scatter: tuple[BlockScatter, ...]

    def __call__(self, X: Array) -> Array:
        """The same in whitened features, (m,) or (m, n)."""
        Z = (X.T / self.sigma).T
        for block in self.scatter:
            part = Z[block.rows]
            Z[block.rows] = part - (block.U * block.less) @ (block.U.T @ part)
        return Z


def whitener(found: Sensitivities) -> Whitener:
    """Of the floor and of the nuisances that are drawn anew in every block."""
    layout = found.layout
    drawn = [index for index, nuisance in enumerate(found.nuisances) if nuisance.each_block]
    if not drawn:
        return Whitener(layout.sigma, ())
    sigma = np.array([found.nuisances[index].sigma for index in drawn])
    L = found.nuisance[:, drawn] * sigma / layout.sigma[:, None]
    scatter = []
    for block in range(len(layout.blocks)):
        rows = np.flatnonzero(layout.block == block)
        if rows.size and np.any(L[rows]):
            U, S, _ = np.linalg.svd(L[rows], full_matrices=False)
            scatter.append(BlockScatter(rows, U, 1.0 - 1.0 / np.sqrt(1.0 + S**2)))
    return Whitener(layout.sigma, tuple(scatter))
