"""How long work tells how far it has come."""

from collections.abc import Callable

Progress = Callable[[float, float, str], None]
"""Told what is done, what is to be done, and what it is."""
