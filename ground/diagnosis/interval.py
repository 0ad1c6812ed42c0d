"""The interval that is told of a number: one level for all of them."""

from typing import Final

LEVEL: Final = 0.9
ENDS: Final = ((1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0)
"""Quantiles between which it lies."""
