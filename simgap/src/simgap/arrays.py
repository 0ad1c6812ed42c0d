"""Types of arrays, the basis of what columns span, and the step to the minimum inside bounds."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


def orthonormal(changes: Array) -> Array:
    """Return an orthonormal basis, (n_rows, rank), of what changes (n_rows, n_sizes) span, without a unit."""
    lengths = np.linalg.norm(changes, axis=0)
    left, values, _ = np.linalg.svd(changes[:, lengths > 0.0] / lengths[lengths > 0.0], full_matrices=False)
    return np.asarray(left[:, values > 1e-8 * np.max(values, initial=0.0)])


def bounded_step(
    hessian: Array, gradient: Array, low: Array, high: Array, unit: Array, rcond: float = 1e-14
) -> Array:
    """Return the step inside bounds, (n,), at which `2 gradient @ step + step @ hessian @ step` is least.

    A step that is only cut at bounds may lead uphill, because its other sizes count on what was cut off.

    Args:
        hessian: Matrix of second derivatives, (n, n), without a negative eigenvalue.
        unit: Scale of each size, (n,): its step times this has no unit.
        rcond: Directions without a unit in which the matrix is below this share of its largest value stay.
    """
    values, vectors = np.linalg.eigh(hessian / np.outer(unit, unit))
    known = values > rcond * np.max(values, initial=0.0)
    root, vectors = np.sqrt(values[known]), vectors[:, known]
    if not len(root):
        return np.zeros_like(gradient)
    aim = -(vectors.T @ (gradient / unit)) / root
    found = lsq_linear(root[:, None] * vectors.T, aim, (low * unit, high * unit), method="bvls")
    return np.asarray(found.x / unit)
