"""How far apart two sides of a channel are: whole numbers as such, floats bit for bit or in a tolerance."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

LEAST: Final = np.finfo(np.float64).smallest_subnormal.item()
"""How far apart 0.0 and -0.0 are: they are not the same."""


def apart(a: NDArray[Any], b: NDArray[Any], tolerance: float) -> NDArray[np.float64]:
    """How far apart numbers are, shape of both; 0 where they are the same, and nowhere else.

    Infinite where only one is a number, LEAST where no number says by how much, as of 0.0 and -0.0.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        off = _distance(a, b)
    if {a.dtype.kind, b.dtype.kind} == {"f"}:
        same = _floats_same(a, b, off, tolerance)
    else:
        same = _exactly_equal(a, b)
    return np.where(same, 0.0, np.where(np.isnan(off), np.inf, np.maximum(off, LEAST)))


def _distance(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """Of whole numbers, that of the integers: as floats, large neighbours are one number."""
    if not (_is_whole(a) and _is_whole(b)):
        return np.abs(a.astype(np.float64) - b.astype(np.float64))
    c, d = a.astype(np.uint64), b.astype(np.uint64)  # negative ones wrap, and so does their difference
    return np.where(a > b, c - d, d - c).astype(np.float64)


def _floats_same(
    a: NDArray[Any], b: NDArray[Any], off: NDArray[np.float64], tolerance: float
) -> NDArray[np.bool_]:
    a, b = a.astype(np.float64), b.astype(np.float64)
    both_nan = np.isnan(a) & np.isnan(b)
    if tolerance == 0.0:
        same: NDArray[np.bool_] = a.view(np.int64) == b.view(np.int64)
    else:
        same = (a == b) | (np.isfinite(off) & (off <= tolerance * np.maximum(1.0, np.abs(a))))
    return np.asarray(same | both_nan)


def _exactly_equal(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Numbers of any two kinds; Python compares an int with a float without rounding it."""
    if _is_whole(a) and _is_whole(b):
        return np.asarray(a == b)
    return np.asarray(a.astype(object) == b.astype(object), np.bool_)


def _is_whole(numbers: NDArray[Any]) -> bool:
    return numbers.dtype.kind in "biu"
