"""Marks of parametrised tests."""

import pytest


def slow_but(values, *short):
    """Return these parameters, each marked slow but for a few that the short tests run too."""
    listed = list(values)
    assert all(one in listed for one in short), f"not among the parameters: {short}"
    return [one if one in short else _slow(one) for one in listed]


def _slow(value):
    arguments = value if type(value) is tuple else (value,)
    return pytest.param(*arguments, marks=pytest.mark.slow)
