"""Arrays as the tuples of floats that commands and parameters are made of."""

from collections.abc import Iterable

from fsw.dictionary.commands import Joints5, Vector3
from fsw.dictionary.params import Row6


def vector3(values: Iterable[float]) -> Vector3:
    """Three numbers."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def joints5(values: Iterable[float]) -> Joints5:
    """One number a joint, in the order of Joint."""
    a, b, c, d, e = (float(value) for value in values)
    return (a, b, c, d, e)


def row6(values: Iterable[float]) -> Row6:
    """A screw, or a row of a compliance."""
    a, b, c, d, e, f = (float(value) for value in values)
    return (a, b, c, d, e, f)
