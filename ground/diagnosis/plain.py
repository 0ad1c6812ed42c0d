"""Numbers as JSON has them."""

from math import isfinite


def finite(value: float) -> float | None:
    """The number; None if it is NaN or infinite, for which JSON has no word."""
    return float(value) if isfinite(value) else None
