"""Types of arrays, and the basis of what columns span."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


def orthonormal(changes: Array) -> Array:
    """Return an orthonormal basis, (n_rows, rank), of what changes (n_rows, n_sizes) span, without a unit."""
    lengths = np.linalg.norm(changes, axis=0)
    left, values, _ = np.linalg.svd(changes[:, lengths > 0.0] / lengths[lengths > 0.0], full_matrices=False)
    return np.asarray(left[:, values > 1e-8 * np.max(values, initial=0.0)])
