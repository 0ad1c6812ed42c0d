"""Validity of commands and parameters as they arrive: types, limits, and combinations that no arm can have.

The annotations of a command say all that is checked of its arguments. A new field needs nothing else.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import IntEnum
from functools import cache
from types import UnionType
from typing import Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary.commands import Command
from fsw.dictionary.params import Params, PartGeometry, RoverPart, ToolParams, Transform6
from fsw.dictionary.types import DirectionMark, Limits, Matrix6, NameMark, match_name

COMPONENT_LIMITS: Final = {"_m": Limits(-5.0, 5.0), "_1_K": Limits(-1e-4, 1e-4)}
"""Limits of the components of every vector, by the unit in its name."""
MAX_COMPLIANCE: Final = 1e-4
"""Largest component of a compliance, in rad or m per N m or N."""
MIN_LINK_M: Final = 0.2
"""Least length of upper arm and forearm; the elbow needs both."""
ORTHOGONAL_RAD: Final = {"arm2": 0.5 * math.pi, "arm3": 0.0, "arm4": 0.0, "arm5": -0.5 * math.pi, "arm6": 0.0}
"""Turn about x from each joint axis to the next in the orthogonal arm; the turn about y is 0."""
MAX_SKEW_RAD: Final = 0.02
"""Largest deviation of an axis from the orthogonal arm.

The inverse kinematics starts from the orthogonal arm, and loses roots from 0.03 on.
"""
MIN_LEAN_RAD: Final = 0.5
"""Least angle between boresight and turret axis; a turn about a parallel boresight has no effect."""
MAX_STOP_DEPTH_RAD: Final = 0.1
"""Largest distance of a hardstop below the soft limit."""
MAX_RATED_SHARE: Final = 0.5
"""Share of the rated torque of a hardstop; speed, noise and friction need the rest."""
ROUNDING: Final = 1e-12
"""Relative rounding error of a symmetric matrix."""


def check_limits(record: Any, place: str = "") -> Iterator[str]:
    """Yield a sentence for each number that is not finite or outside its limits, and for each empty range."""
    hints = get_type_hints(type(record), include_extras=True)
    for field in fields(record):
        value, where = getattr(record, field.name), f"{place}{field.name}"
        if is_dataclass(value):
            yield from check_limits(value, f"{where}.")
            continue
        if isinstance(value, tuple) and value and is_dataclass(value[0]):
            for k, item in enumerate(value):
                yield from check_limits(item, f"{where}.{getattr(item, 'name', k)}.")
            continue
        if not all(math.isfinite(v) for v in _leaf_numbers(value)):
            yield f"{where}: must be finite, is {value}"
            continue
        for limits in getattr(hints[field.name], "__metadata__", ()):
            if isinstance(limits, Limits) and not limits.low <= value <= limits.high:
                yield f"{where}: {value} is outside {limits.low} .. {limits.high}"
        for unit, limits in COMPONENT_LIMITS.items():
            if field.name.endswith(unit) and isinstance(value, tuple):
                for k, component in enumerate(value):
                    if not limits.low <= component <= limits.high:
                        yield f"{where}.{k}: {component} is outside {limits.low} .. {limits.high}"
    for low in (field.name for field in fields(record) if "_min_" in field.name):
        high = low.replace("_min_", "_max_")
        if not getattr(record, low) < getattr(record, high):
            yield f"{place}{low}: {getattr(record, low)} is not below {high} {getattr(record, high)}"


def check_arm(params: Params) -> Iterator[str]:
    """Yield a sentence for each combination of numbers within their limits that no arm can have."""
    for field in fields(params.links):
        link, where = getattr(params.links, field.name), f"links.{field.name}"
        problem = _check_compliance(link.compliance)
        if problem is not None:
            yield f"{where}.compliance: {problem}"
        yield from _check_axes(field.name, link.transform)
    yield from _check_names(params)
    yield from _check_boresights(params.tools)
    yield from _check_poses(params)
    yield from _check_hardstops(params)
    yield from _check_geometry(params)


def _check_axes(name: str, link: Transform6) -> Iterator[str]:
    """Yield a sentence for each link that is too short, or whose axes deviate from the orthogonal arm."""
    where = f"links.{name}.transform"
    if name in ("arm3", "arm4") and link.a_m < MIN_LINK_M:
        yield f"{where}.a_m: {link.a_m} is below {MIN_LINK_M}, the shortest link"
    if name not in ORTHOGONAL_RAD:
        return
    for angle, value, orthogonal in (
        ("alpha_rad", link.alpha_rad, ORTHOGONAL_RAD[name]),
        ("beta_rad", link.beta_rad, 0.0),
    ):
        if abs(value - orthogonal) > MAX_SKEW_RAD:
            nominal = f"the orthogonal arm's {orthogonal:.6g}"
            yield f"{where}.{angle}: {value} is not within {MAX_SKEW_RAD} of {nominal}"


def _check_names(params: Params) -> Iterator[str]:
    """Yield a sentence for each name that is used twice, and for each tool that is not among the tools."""
    names = params.tool_names
    if not names:
        yield "tools: is empty; an arm has at least one tool"
    for place, given in (
        ("tools", names),
        ("switches", [switch.name for switch in params.switches]),
        ("collision.rover", [part.name for part in params.collision.rover]),
    ):
        yield from (
            f"{place}: {name} is there twice" for name in sorted({n for n in given if given.count(n) > 1})
        )
    known = ", ".join(names)
    uses = [(f"switches.{switch.name}", switch.tool) for switch in params.switches]
    uses += [(f"teach.{point.name}.tool", point.tool) for point in params.teach]
    yield from (
        f"{place}: tool {tool!r} is not known; there are {known}" for place, tool in uses if tool not in names
    )


def _check_boresights(tools: tuple[ToolParams, ...]) -> Iterator[str]:
    """Yield a sentence for each tool whose boresight is nearly parallel to the turret axis."""
    for tool in tools:
        beta = tool.transform.beta_rad
        if math.asin(abs(math.cos(beta))) < MIN_LEAN_RAD:
            where = f"tools.{tool.name}.transform.beta_rad"
            yield f"{where}: {beta} brings the boresight within {MIN_LEAN_RAD} of the turret axis"


def _check_poses(params: Params) -> Iterator[str]:
    """Yield a sentence for each named pose beyond the soft limits."""
    poses = {"poses.stowed_rad": params.poses.stowed_rad, "poses.ready_rad": params.poses.ready_rad}
    poses |= {f"poses.unstow_via_rad.{k}": via for k, via in enumerate(params.poses.unstow_via_rad)}
    stops = params.hardstop
    poses |= {
        f"hardstop.{name}": getattr(stops, name) for name in ("start_rad", "park_rad", "second_start_rad")
    }
    for name, pose in poses.items():
        for field, joint, angle in zip(fields(params.joints), params.joints.in_order(), pose, strict=True):
            if not joint.soft_min_rad <= angle <= joint.soft_max_rad:
                yield (
                    f"{name}: joint {field.name}: {angle} is outside its soft limits "
                    f"{joint.soft_min_rad:.6g} .. {joint.soft_max_rad:.6g}"
                )


def _check_hardstops(params: Params) -> Iterator[str]:
    """Yield a sentence for each hardstop too far from the soft limit, or pressed too hard."""
    room_rad = params.monitors.soft_limit_margin_rad
    for field, joint in zip(fields(params.joints), params.joints.in_order(), strict=True):
        low, high = joint.soft_min_rad - MAX_STOP_DEPTH_RAD, joint.soft_min_rad - room_rad
        if not low <= joint.hardstop_rad <= high:
            yield (
                f"joints.{field.name}.hardstop_rad: {joint.hardstop_rad} is not between {room_rad} and "
                f"{MAX_STOP_DEPTH_RAD} below soft_min_rad, {low:.6g} .. {high:.6g}"
            )
        most_Nm = MAX_RATED_SHARE * joint.hardstop_rated_Nm
        if joint.hardstop_press_Nm > most_Nm:
            yield (
                f"joints.{field.name}.hardstop_press_Nm: {joint.hardstop_press_Nm} is above {most_Nm:g}, "
                f"{MAX_RATED_SHARE} of hardstop_rated_Nm"
            )


def _check_geometry(params: Params) -> Iterator[str]:
    """Yield a sentence for each part without a shape, and for each box with a negative edge."""
    parts: list[tuple[str, PartGeometry | RoverPart]] = [
        (f"collision.arm.{field.name}", getattr(params.collision.arm, field.name))
        for field in fields(params.collision.arm)
    ]
    parts += [(f"tools.{tool.name}.geometry", tool.geometry) for tool in params.tools]
    parts += [(f"collision.rover.{part.name}", part) for part in params.collision.rover]
    for where, shapes in parts:
        if not shapes.capsules and not shapes.boxes:
            yield f"{where}: has neither capsules nor boxes; a part needs at least one shape"
        for k, box in enumerate(shapes.boxes):
            if min(box.half_m) <= 0:
                yield f"{where}.boxes.{k}.half_m: {box.half_m} must be positive"


def _check_compliance(compliance: Matrix6) -> str | None:
    """Return the reason why no spring has this compliance; scaled so that its diagonal is 1."""
    C = np.array(compliance)
    if np.abs(C).max() > MAX_COMPLIANCE:
        worst = C.flat[np.abs(C).argmax()]
        limits = f"{-MAX_COMPLIANCE} .. {MAX_COMPLIANCE}"
        return f"{worst} is outside {limits} (rad or m, per N m or N), no link is as soft"
    unit = np.sqrt(np.abs(np.diag(C)))
    scale = np.outer(unit, unit)
    asymmetric = np.abs(C - C.T) > ROUNDING * scale
    if np.any(asymmetric):
        row, column = np.argwhere(asymmetric)[0]
        there, across = C[row, column], C[column, row]
        return f"is not symmetric: {there} at [{row}][{column}], {across} across the diagonal"
    positive_unit = np.where(unit > 0, unit, 1.0)
    weakest = np.linalg.eigvalsh(C / np.outer(positive_unit, positive_unit)).min()
    if np.any(np.abs(C) > scale * (1 + ROUNDING)) or weakest < -ROUNDING:
        return "is not positive semidefinite: under some load the link would give way against the load"
    return None


def _leaf_numbers(value: Any) -> Iterator[float]:
    """Yield all floats of a nested tuple."""
    if isinstance(value, tuple):
        for item in value:
            yield from _leaf_numbers(item)
    elif isinstance(value, float):
        yield value


COMMAND_TYPES: Final = frozenset(get_args(Command))
MAX_TEXT_LENGTH: Final = 100
"""Greatest length of a text; twice that of the longest name of a parameter."""
MAX_SHOWN_LENGTH: Final = 40
"""Longest part of a text in a sentence."""

MAX_FLOAT: Final = float(np.finfo(float).max)

Names = Mapping[NameMark, tuple[str, ...]]
"""Names that the arm and the flight software know, by the mark of the fields that hold one of them."""
C = TypeVar("C", bound=Command)


@dataclass(frozen=True, slots=True)
class Wrong:
    """Problem with a command or a value, and what would be right."""

    text: str


def read_arguments(command: C, names: Names) -> C | Wrong:
    """Read a command of any arguments as one of plain values of the types in its annotations.

    A number may be an int, a float or a scalar of numpy, and a vector any sequence of them. A name may have
    any case.

    Args:
        command: Command; it may be any object.
    """
    kind: type = type(command)
    if not any(kind is one for one in COMMAND_TYPES):  # a class itself may have no hash
        return Wrong(f"is no command; there are {', '.join(sorted(one.__name__ for one in COMMAND_TYPES))}")
    values: dict[str, Any] = {}
    for field, hint in _hints(kind).items():
        if not hasattr(command, field):
            return Wrong(f"{field}: is missing")
        value = _read_value(hint, getattr(command, field), names)
        if isinstance(value, Wrong):
            return Wrong(f"{field}: {value.text}")
        values[field] = value
    plain: C = kind(**values)
    return plain


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _read_value(hint: Any, value: object, names: Names) -> Any:
    """Return a value as its annotation wants it, or what is wrong with it."""
    marks = getattr(hint, "__metadata__", ())
    bare = hint.__origin__ if marks else hint
    if get_origin(bare) in (Union, UnionType):
        wanted, _ = get_args(bare)  # a value or None
        return None if value is None else _read_value(wanted, value, names)
    for mark in marks:
        if isinstance(mark, NameMark):
            return _read_name(names[mark], value)
    if get_origin(bare) is tuple:
        return _read_vector(bare, marks, value)
    if get_origin(bare) is Literal:
        return _read_name(get_args(bare), value)
    if bare is float:
        return _read_number(marks, value)
    if bare is bool:
        is_flag = isinstance(value, bool | np.bool_)
        return bool(value) if is_flag else Wrong(f"{_describe(value)} is not True or False")
    if bare is str:
        return _read_text(value)
    if isinstance(bare, type) and issubclass(bare, IntEnum):
        return _read_member(bare, value)
    raise TypeError(f"a command cannot hold a {bare}")


def _read_number(marks: tuple[Any, ...], value: object) -> float | Wrong:
    """Return a finite number within its limits."""
    if not _is_number(value):
        return Wrong(f"{_describe(value)} is not a number")
    number = _to_float(value)
    for mark in marks:
        if isinstance(mark, Limits) and not mark.low <= number <= mark.high:
            return Wrong(f"{number} is outside {mark.low:g} .. {mark.high:g}")
    return number if math.isfinite(number) else Wrong(f"{number} is not a finite number")


def _read_vector(hint: Any, marks: tuple[Any, ...], value: object) -> tuple[float, ...] | Wrong:
    """Return as many numbers as the annotation has, each within the limits."""
    count = len(get_args(hint))
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    if not isinstance(value, tuple | list):
        return Wrong(f"{_describe(value)} is not a sequence of {count} numbers")
    if len(value) != count:
        return Wrong(f"has {len(value)} numbers; must have {count}")
    numbers: list[float] = []
    for k, item in enumerate(value):
        number = _read_number(marks, item)
        if isinstance(number, Wrong):
            return Wrong(f"number {k + 1}: {number.text}")
        numbers.append(number)
    for mark in marks:
        if isinstance(mark, DirectionMark) and max(map(abs, numbers)) < mark.least:
            return Wrong(f"has no length; its greatest component must be at least {mark.least:g}")
    return tuple(numbers)


def _read_name(known: tuple[str, ...], value: object) -> str | Wrong:
    """Return the known name that a text stands for, in any case."""
    name = match_name(value, known)
    return Wrong(f"{_describe(value)} is not known; there are {', '.join(known)}") if name is None else name


def _read_text(value: object) -> str | Wrong:
    if not isinstance(value, str) or not value.isprintable():
        return Wrong(f"{_describe(value)} is not printable text")
    if not value:
        return Wrong("is empty; a name is right")
    if len(value) > MAX_TEXT_LENGTH:
        return Wrong(f"{_describe(value)} has {len(value)} characters; at most {MAX_TEXT_LENGTH} are allowed")
    return str(value)


def _read_member(kind: type[IntEnum], value: object) -> IntEnum | Wrong:
    """Return the member with this number or, in any case, this name."""
    names = [one.name.lower() for one in kind]
    name = match_name(value, names)
    if name is not None:
        return kind[name.upper()]
    if _is_number(value) and isinstance(value, int | np.integer):
        for member in kind:
            if member == value:
                return member
    return Wrong(f"{_describe(value)} is not known; there are {', '.join(names)}")


def _describe(value: object) -> str:
    """Describe a value of any type in a few characters; the text of a foreign object may be anything."""
    if isinstance(value, str):
        text = value if len(value) <= MAX_SHOWN_LENGTH else f"{value[:MAX_SHOWN_LENGTH]}..."
        return ascii(text) if not text.isprintable() else repr(text)
    if value is None or isinstance(value, bool):
        return str(value)
    if _is_number(value) and isinstance(value, int | np.integer):
        return f"{_to_float(value):.17g}"
    if _is_number(value):
        return str(_to_float(value))
    return f"a value of type {type(value).__name__[:MAX_SHOWN_LENGTH]}"


def _is_number(value: object) -> bool:
    """Return whether a value is a number of Python or numpy; other classes may do anything when used."""
    if isinstance(value, np.integer | np.floating):
        return not isinstance(value, np.timedelta64)
    return type(value) in (int, float) or isinstance(value, IntEnum)


def _to_float(value: Any) -> float:
    """Convert a number; one beyond all floats is infinite."""
    if isinstance(value, int) and abs(value) > MAX_FLOAT:
        return math.inf if value > 0 else -math.inf
    return float(value)
