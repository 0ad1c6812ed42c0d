"""Value types of commands, channels and parameters: limits, vectors, and arrays as tuples of floats."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args

Record = TypeVar("Record")


@dataclass_transform(frozen_default=True, eq_default=False)
def cycle_record(record: type[Record]) -> type[Record]:
    """Make a class a record of which every cycle makes a new one.

    The type checker holds it frozen. To freeze it at run time as well takes five times as long.
    """
    return dataclass(slots=True, eq=False)(record)


@dataclass(frozen=True, slots=True)
class Limits:
    """Closed range of plausible values of a number."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ToolMark:
    """Mark of a field that names a tool of the arm."""


@dataclass(frozen=True, slots=True)
class SwitchMark:
    """Mark of a field that names a contact switch of the arm."""


ToolName = Annotated[str, ToolMark()]
"""Name of a tool, in capitals."""
SwitchName = Annotated[str, SwitchMark()]
"""Name of a contact switch, in capitals."""


def names_tool(hint: Any) -> bool:
    """Return whether an annotation, or one of its alternatives, is a ToolName."""
    marks = getattr(hint, "__metadata__", ())
    return any(isinstance(mark, ToolMark) for mark in marks) or any(map(names_tool, get_args(hint)))


Length = Annotated[float, Limits(-5.0, 5.0)]
Angle = Annotated[float, Limits(-7.0, 7.0)]

Vector3 = tuple[float, float, float]
Joints5 = tuple[float, float, float, float, float]
Row6 = tuple[float, float, float, float, float, float]
Matrix6 = tuple[Row6, Row6, Row6, Row6, Row6, Row6]


def vector3(values: Iterable[float]) -> Vector3:
    """Convert three numbers to a vector."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def joints5(values: Iterable[float]) -> Joints5:
    """Convert one number per joint to a tuple, in the order of Joint."""
    a, b, c, d, e = (float(value) for value in values)
    return (a, b, c, d, e)


def row6(values: Iterable[float]) -> Row6:
    """Convert six numbers to a screw or a row of a compliance."""
    a, b, c, d, e, f = (float(value) for value in values)
    return (a, b, c, d, e, f)
