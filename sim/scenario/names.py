"""Names of dataclasses and their fields in scenario files, with units."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from math import pi
from typing import Any, Final

UNIT_FACTORS: Final[dict[str, dict[str, float]]] = {
    "rad": {"rad": 1.0, "deg": pi / 180},
    "m": {"m": 1.0, "mm": 1e-3},
    "N": {"N": 1.0},
    "s": {"s": 1.0},
    "C": {"degC": 1.0},
    "A": {"A": 1.0},
    "Nm": {"Nm": 1.0},
}
"""Suffixes in a file by suffix of the field, with their value in its SI unit."""

MAX_SHOWN_LENGTH: Final = 60
"""Longest text from a file in a message."""

_POSITION: Final = re.compile(r"p_(?:[A-Z]o[A-Z]o_)?[A-Z]_m$")
_PER: Final = re.compile(r"_(?:rad|m|s|A|N|Nm|Nms|K)$")
_FRAME: Final = re.compile(r"_[A-Z]$")


@dataclass(frozen=True, slots=True)
class FieldKeys:
    """Keys of a scenario file for one field."""

    field: str
    stem: str
    factors: dict[str, float]
    """SI value per value in the file, by key; a field without unit has one key."""

    def __str__(self) -> str:
        return " or ".join(self.factors)


def field_keys(field: str, kind: Any) -> FieldKeys:
    """Return the keys of a field: without frames, `position` for p, and with any unit that fits."""
    name = _POSITION.sub("position_m", field)
    if kind is not float:  # the last capital of a number is a unit
        name = _FRAME.sub("", name)
    stem, _, unit = name.rpartition("_")
    if not stem or unit not in UNIT_FACTORS or _PER.search(stem):  # a unit per another has one spelling
        return FieldKeys(field, name, {name: 1.0})
    return FieldKeys(
        field, stem, {f"{stem}_{suffix}": factor for suffix, factor in UNIT_FACTORS[unit].items()}
    )


def is_position(field: str) -> bool:
    """Return whether a field is the position of a point."""
    return _POSITION.search(field) is not None


def shorten(key: str) -> str:
    """Return a text from a file, short and printable enough for a message."""
    text = key if key.isprintable() else repr(key)
    return text if len(text) <= MAX_SHOWN_LENGTH else f"{text[: MAX_SHOWN_LENGTH - 3]}..."


def upper_snake(kind: type) -> str:
    """Return the name of a class in a file: MoveTool is MOVE_TOOL."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).upper()


def list_choices(known: Iterable[str]) -> str:
    """Return a list of names as the end of a message."""
    return f"there are {', '.join(known) or 'none'}"


def did_you_mean(value: object, known: Iterable[str]) -> str:
    """Suggest the closest name, or part of `one or other`, and list all names.

    A value that is no text is near to no name.
    """
    names = list(known)
    advice = suggest_name(value, names) if isinstance(value, str) else ""
    return advice + list_choices(names)


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Return a question about the closest name, to put before more advice; empty if none is close."""
    near = {part: whole for whole in known for part in whole.split(" or ")}
    lower = {part.lower(): whole for part, whole in near.items()}
    close = get_close_matches(name.lower(), lower, n=1)
    return f"did you mean {lower[close[0]]}? " if close else ""
