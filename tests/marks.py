"""Marks of parametrised tests."""

from collections.abc import Iterable
from typing import Any

import pytest


def slow_but(values: Iterable[Any], *short: Any) -> list[Any]:
    """Return these parameters, each marked slow but for a few that `make test` runs too."""
    listed = list(values)
    assert set(short) <= set(listed), f"not among the parameters: {short}"
    slow = pytest.mark.slow
    return [one if one in short else pytest.param(*_arguments(one), marks=slow) for one in listed]


def _arguments(value: Any) -> tuple[Any, ...]:
    return value if type(value) is tuple else (value,)
