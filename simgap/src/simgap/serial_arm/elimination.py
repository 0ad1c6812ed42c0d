"""Fits without some parameters, linearised at a fit: of all poses, and without each block of time."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.serial_arm.fit import MIN_SENSITIVITY, Fit

BLOCKS: Final = 10
"""Number of blocks of time: a standard error of ten values is known within a quarter."""


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """Values with some parameters at zero."""

    values: Array
    """Values from all poses in the units of the parameters, shape (p,)."""
    by_block: Array
    """Values from the poses outside of each block, shape (b, p)."""
    block_error: Array
    """Root mean square whitened residual of each block, predicted from the others, shape (b,)."""


class Elimination:
    """Normal equations of a fit, by block of time, solved for any part of the parameters."""

    def __init__(self, fitted: Fit):
        used = fitted.used
        self._fit = fitted
        self._scale = np.array([one.scale for one in fitted.parameters])
        prior = self._scale / np.array([one.prior_sigma for one in fitted.parameters])
        self._J = fitted.at.jacobian[used] * self._scale
        self._r = fitted.at.residual[used]
        self.block: Integers = np.arange(self._r.shape[0]) * BLOCKS // self._r.shape[0]
        parts = [self._J[self.block == k].reshape(-1, self._scale.size) for k in range(BLOCKS)]
        H = np.array([part.T @ part for part in parts])
        g = np.array([part.T @ self._r[self.block == k].ravel() for k, part in enumerate(parts)])
        penalty = np.diag(prior**2 + MIN_SENSITIVITY**2)
        pull = prior**2 * fitted.values / self._scale
        left_out = [np.zeros_like(H[0]), *H], [np.zeros_like(g[0]), *g]
        self._inverse = [np.linalg.inv(H.sum(axis=0) - part + penalty) for part in left_out[0]]
        self._gradient = [g.sum(axis=0) - part + pull for part in left_out[1]]

    def without(self, removed: Flags) -> Eliminated:
        """Fit with some parameters at zero.

        Args:
            removed: Boolean flags of these parameters, shape (p,).

        Returns:
            Values of all parameters, and errors of blocks that took no part.
        """
        steps = [self._step(H, g, removed) for H, g in zip(self._inverse, self._gradient, strict=True)]
        error = np.empty(BLOCKS)
        for k in range(BLOCKS):
            here = self.block == k
            error[k] = np.sqrt(np.mean((self._r[here] + self._J[here] @ steps[k + 1]) ** 2))
        values = self._fit.values + np.array(steps) * self._scale
        values[:, removed] = 0.0
        return Eliminated(values[0], values[1:], error)

    def _step(self, inverse: Array, gradient: Array, removed: Flags) -> Array:
        """Solve the normal equations under the constraint that the values of some parameters become zero."""
        step = -inverse @ gradient
        if removed.any():
            excess = step[removed] + (self._fit.values / self._scale)[removed]
            step = step - inverse[:, removed] @ np.linalg.solve(inverse[np.ix_(removed, removed)], excess)
        return step


def jackknife_sigma(by_block: Array) -> Array:
    """Compute standard errors of numbers from their values without each block.

    Blocks differ by all that the model lacks, so these know more than the covariance of a fit.

    Args:
        by_block: Numbers in any unit, shape (b, k).

    Returns:
        Standard errors in their unit, shape (k,).
    """
    b = by_block.shape[0]
    sigma: Array = np.sqrt((b - 1) * np.var(by_block, axis=0))
    return sigma
