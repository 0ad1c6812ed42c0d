"""Arguments of commands as they arrive: the annotations of a command say all that is checked of them.

A new field needs nothing else.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import UnionType
from typing import Any, Final, Literal, TypeVar, Union, get_args, get_origin

import numpy as np

from fsw.dictionary.commands import Command
from fsw.dictionary.types import DirectionMark, Limits, NameMark, match_name
from fsw.dictionary.validity import read_hints

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
    """Read a command of any arguments, or any object, as one of plain values of the types in its annotations.

    A number may be an int, a float or a scalar of numpy, and a vector any sequence of them. A name may have
    any case.
    """
    kind: type = type(command)
    if not any(kind is one for one in COMMAND_TYPES):  # a class itself may have no hash
        return Wrong(f"is no command; there are {', '.join(sorted(one.__name__ for one in COMMAND_TYPES))}")
    values: dict[str, Any] = {}
    for field, hint in read_hints(kind).items():
        if not hasattr(command, field):
            return Wrong(f"{field}: is missing")
        value = _read_value(hint, getattr(command, field), names)
        if isinstance(value, Wrong):
            return Wrong(f"{field}: {value.text}")
        values[field] = value
    plain: C = kind(**values)
    return plain


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
