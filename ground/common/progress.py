"""Interface for progress reports of long work."""

from collections.abc import Callable

Progress = Callable[[float, float, str], None]
"""Function of the amount done, the total amount, and the name of the current activity."""
