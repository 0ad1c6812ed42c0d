"""Value types of commands, channels and parameters: limits, vectors, and arrays as tuples of floats."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Final, TypeVar, dataclass_transform, get_args

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


class NameMark(Enum):
    """Mark of a field that holds one of the known names."""

    TOOL = "tool of the arm"
    SWITCH = "contact switch of the arm"
    FRAME = "frame in which a command is given"
    BRANCH = "branch of the inverse kinematics, or auto"


@dataclass(frozen=True, slots=True)
class DirectionMark:
    """Mark of a direction of any length; a vector with a smaller greatest component has no direction."""

    least: float


ToolName = Annotated[str, NameMark.TOOL]
"""Name of a tool, in small letters."""
SwitchName = Annotated[str, NameMark.SWITCH]
"""Name of a contact switch, in small letters."""
FrameName = Annotated[str, NameMark.FRAME]
"""Name of a frame, in small letters."""
BranchName = Annotated[str, NameMark.BRANCH]
"""AUTO, or one of the names in kinematics.branches.BRANCHES."""
AUTO: Final = "auto"
"""Name of a branch that flight software chooses."""


def match_name(text: object, known: Iterable[str]) -> str | None:
    """Return the known name that a text stands for, in any case; None if it is none of them."""
    return next((name for name in known if isinstance(text, str) and name.lower() == text.lower()), None)


def names_tool(hint: Any) -> bool:
    """Return whether an annotation, or one of its alternatives, is a ToolName."""
    return NameMark.TOOL in getattr(hint, "__metadata__", ()) or any(map(names_tool, get_args(hint)))


Length = Annotated[float, Limits(-5.0, 5.0)]
"""Length in the model of an arm; twice the reach of the largest."""
Angle = Annotated[float, Limits(-7.0, 7.0)]
"""Angle; a full turn and a tenth, as no joint turns farther."""

Vector3 = tuple[float, float, float]
Position = Annotated[Vector3, Limits(-20.0, 20.0)]
"""Position of a target [m]; ten times the reach, so that a target beyond it is a wrong unit or frame."""
Direction = Annotated[Vector3, Limits(-1e9, 1e9), DirectionMark(1e-9)]
"""Direction of any length; squares of its components keep all their digits within these limits."""
Distance = Annotated[float, Limits(1e-3, 1.0)]
"""Straight distance [m]: a millimetre, the play of the joints at the tool, up to half of the reach."""
DistanceOrZero = Annotated[float, Limits(0.0, 1.0)]
"""Straight distance [m] that may be 0; at most half of the reach."""
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
