"""Arithmetic on the 6x6 compliances of flight parameters, which are tuples."""

import numpy as np

from fsw.dictionary.types import Matrix6, row6
from fsw.kinematics.transforms import Array


def scaled(matrix: Matrix6, factor: float) -> Matrix6:
    """Every element times a factor."""
    return _matrix6(np.array(matrix) * factor)


def turned(matrix: Matrix6, R: Array) -> Matrix6:
    """The same spring seen from axes turned back by R: both its rotations and its translations turn."""
    both = np.kron(np.eye(2), R)
    return _matrix6(both @ np.array(matrix) @ both.T)


def softened(matrix: Matrix6, axis: int, more: float) -> Matrix6:
    """More on one place of the diagonal."""
    values = np.array(matrix)
    values[axis, axis] += more
    return _matrix6(values)


def _matrix6(values: Array) -> Matrix6:
    a, b, c, d, e, f = (row6(row) for row in values)
    return (a, b, c, d, e, f)
