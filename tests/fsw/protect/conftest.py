"""Bounds of protection for all tests of this folder."""

from dataclasses import fields

import pytest

from fsw.config import CYCLE_S
from fsw.protect.inputs import compute_bounds
from tests.fsw.protect.lab import BOUNDS, CONFIG, PARAMS


@pytest.fixture(autouse=True)
def _bounds_of_this_test():
    """Compute the bounds again: mutmut changes functions only after it has imported the tests."""
    fresh = compute_bounds(PARAMS, CONFIG.arm, CYCLE_S)
    for field in fields(fresh):
        object.__setattr__(BOUNDS, field.name, getattr(fresh, field.name))
