"""Types of arrays, the basis of what columns span, and the minimum inside bounds."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

Array = NDArray[np.float64]
Slopes = NDArray[np.float32]
"""Derivatives by differences: they are known to three digits, and fill the memory."""
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


def orthonormal(changes: Array) -> Array:
    """Return an orthonormal basis, (n_rows, rank), of what changes (n_rows, n_sizes) span, without a unit."""
    lengths = np.linalg.norm(changes, axis=0)
    changes = changes[:, lengths > 0.0]
    changes /= lengths[lengths > 0.0]  # in place, as those at all joints are large
    left, values, _ = np.linalg.svd(changes, full_matrices=False)
    known = values > 1e-8 * np.max(values, initial=0.0)
    return np.asarray(left if known.all() else left[:, known])


def find_bounded_minimum(
    hessian: Array, gradient: Array, at: Array, bounds: tuple[Array, Array], unit: Array, rcond: float = 1e-14
) -> Array:
    """Return where `2 gradient @ step + step @ hessian @ step` is least inside bounds, (n,), from `at`.

    A step that is only cut at bounds may lead uphill, because its other sizes count on what was cut off. What
    ends at a bound has exactly its value.

    Args:
        hessian: Matrix of second derivatives, (n, n), without a negative eigenvalue.
        bounds: Lower and upper bounds, (n,) each; `at` is inside.
        unit: Scale of each size, (n,): its step times this has no unit.
        rcond: Along directions without a unit in which the matrix is below this share of its largest value,
            no step is made.
    """
    low, high = bounds
    values, vectors = np.linalg.eigh(hessian / np.outer(unit, unit))
    known = values > rcond * np.max(values, initial=0.0)
    free = low < high
    if not known.any() or not free.any():
        return at
    root = np.sqrt(np.where(known, values, np.max(values)))  # what is not known is stiff
    aim = np.where(known, -(vectors.T @ (gradient / unit)) / root, 0.0)
    room = ((low - at) * unit)[free], ((high - at) * unit)[free]
    found = lsq_linear((root[:, None] * vectors.T)[:, free], aim, room, method="bvls")
    end = at.copy()
    end[free] = np.clip(at[free] + found.x / unit[free], low[free], high[free])
    end[free] = np.where(
        found.active_mask < 0, low[free], np.where(found.active_mask > 0, high[free], end[free])
    )
    return end
