"""Frozen dataclasses from tables of a scenario file: names with units, types by pydantic, and limits."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from enum import IntEnum
from functools import cache
from math import pi
from types import UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import Field, ValidationError, create_model

from fsw.dictionary.types import DirectionMark, Limits, match_name, names_tool
from simgap.common.toml import KeyPath, Record, describe_fault, key_path

T = TypeVar("T")
Choices = Mapping[str, tuple[str, ...]]
"""Allowed texts, by name of a field."""

NO_CHOICES: Final[Choices] = {}
TYPE_KEY: Final = "type"
"""Key that names the dataclass of a table."""

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


@dataclass(frozen=True, slots=True)
class Findings:
    """Problems of a file, collected while it is read."""

    tools: tuple[str, ...] = ()
    """Names of the tools of the arm; none if the file names no tool."""
    problems: list[str] = field(default_factory=list)
    """Sentences with the path of the key."""

    def report(self, place: KeyPath, text: str) -> None:
        """Add a problem with the value at a place."""
        self.problems.append(f"{key_path(place)}: {text}" if place else text)


class _BadValue(Exception):
    """Value that its field refuses."""


def read_record(
    kind: type[T], table: dict[str, Any], place: KeyPath, findings: Findings, choices: Choices = NO_CHOICES
) -> T | None:
    """Read a table as a dataclass, with fields that a file may set; None adds its problems to `findings`."""
    before = len(findings.problems)
    hints = get_type_hints(kind, include_extras=True)
    words = {f.name: field_keys(f.name, _bare_type(hints[f.name])) for f in fields(kind)}  # type: ignore[arg-type]
    said = _match_keys(list(words.values()), table, place, findings)
    values: dict[str, Any] = {}
    for f in fields(kind):  # type: ignore[arg-type]
        key = said.get(f.name)
        if key in words[f.name].factors:
            factor = words[f.name].factors[key]
            known = findings.tools if names_tool(hints[f.name]) else choices.get(f.name)
            values[f.name] = _read_value(hints[f.name], table[key], (*place, key), findings, factor, known)
        elif key is None and f.default is MISSING and f.default_factory is MISSING:
            findings.report((*place, str(words[f.name])), "is missing")
    if len(findings.problems) > before:
        return None
    try:
        return kind(**values)
    except ValueError as error:  # fields that contradict each other
        findings.report(place, str(error))
        return None


def require_table(value: Any, place: KeyPath, findings: Findings) -> dict[str, Any] | None:
    """Return the value as a table, or None and a problem."""
    if isinstance(value, dict):
        return value
    findings.report(place, f"{_show(value)} is no table; write [{place[-1]}] and its keys below")
    return None


def list_tables(
    data: dict[str, Any], what: str, findings: Findings
) -> Iterator[tuple[KeyPath, dict[str, Any]]]:
    """List each table of a list of tables, with its place."""
    found = data.get(what, [])
    if isinstance(found, list) and all(isinstance(table, dict) for table in found):
        yield from (((what, k), table) for k, table in enumerate(found))
    else:
        findings.report((what,), f"is no list of tables; write [[{what}]] and its keys below, once for each")


def read_kind(
    kinds: Mapping[str, type[T]], table: dict[str, Any], place: KeyPath, findings: Findings
) -> type[T] | None:
    """Return the dataclass that a table names as its type, or None and a problem."""
    name = table.get(TYPE_KEY)
    if isinstance(name, str) and name in kinds:
        return kinds[name]
    why = f"{_show(name)} is not known; {did_you_mean(name, kinds)}"
    findings.report((*place, TYPE_KEY), why if TYPE_KEY in table else f"is missing; {list_choices(kinds)}")
    return None


def _match_keys(
    words: list[FieldKeys], table: dict[str, Any], place: KeyPath, findings: Findings
) -> dict[str, str]:
    """Find the key of each field; report unknown keys, wrong units and duplicates."""
    said: dict[str, str] = {}
    for key in table:
        meant = next((w for w in words if key in w.factors), None) or _without_unit(key, words)
        problem = None
        if meant is None:
            problem = f"is not known here; {did_you_mean(key, map(str, words))}"
        elif meant.field in said:
            problem = f"{said[meant.field]} sets the same field; give one of the two"
        else:
            said[meant.field] = key
            if key not in meant.factors:
                problem = f"has {'no' if key == meant.stem else 'another'} unit; write {meant}"
        if problem is not None:
            findings.report((*place, shorten(key)), problem)
    return said


def _without_unit(key: str, words: list[FieldKeys]) -> FieldKeys | None:
    """Find the field of a key whose unit is missing or wrong."""
    with_unit = [w for w in words if w.stem not in w.factors]
    return next((w for w in with_unit if key == w.stem or key.startswith(f"{w.stem}_")), None)


def _read_value(
    kind: Any, value: Any, place: KeyPath, findings: Findings, factor: float, choices: tuple[str, ...] | None
) -> Any:
    plain = _bare_type(kind)
    if is_dataclass(plain):
        table = require_table(value, place, findings)
        return None if table is None else read_record(plain, table, place, findings)  # type: ignore[arg-type]
    try:
        read = _convert_value(plain, value, factor, choices)
        for mark in getattr(kind, "__metadata__", ()):
            _check_mark(mark, read, factor)
    except _BadValue as wrong:
        findings.report(place, str(wrong))
        return None
    except ValidationError as error:
        fault: Any = error.errors()[0]
        findings.report((*place, *fault["loc"][1:]), describe_fault(plain, fault))
        return None
    return read


def _convert_value(kind: Any, value: Any, factor: float, choices: tuple[str, ...] | None) -> Any:
    if get_origin(kind) is Literal or choices is not None:
        return _match_choice(get_args(kind) if choices is None else choices, value)
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return kind[_match_choice(tuple(member.name.lower() for member in kind), value).upper()]
    read = _value_model(kind).model_validate({"value": tuple(value) if isinstance(value, list) else value})
    number = read.value  # type: ignore[attr-defined]
    if isinstance(number, tuple):
        return tuple(one if isinstance(one, bool | str) else one * factor for one in number)
    return number * factor if kind is float else number


@cache
def _value_model(kind: Any) -> type[Record]:
    """Make the strict reader of a type; a list must have a value."""
    several = get_origin(kind) is tuple and ... in get_args(kind)
    return create_model("Value", __base__=Record, value=(kind, Field(min_length=1) if several else ...))


def _bare_type(kind: Any) -> Any:
    """Return the type without limits and without None; a missing value has its default."""
    while get_origin(kind) in (Annotated, UnionType, Union):
        kind = get_args(kind)[0]
    return kind


def _match_choice(known: tuple[str, ...], value: Any) -> str:
    name = match_name(value, known)
    if name is None:
        raise _BadValue(f"{_show(value)} is not known; {did_you_mean(value, known)}")
    return name


def _check_mark(mark: Any, value: Any, factor: float) -> None:
    """Check a value by a mark of its type, in the units of the file."""
    if isinstance(mark, Limits):
        for one in value if isinstance(value, tuple) else (value,):
            if not mark.low <= one <= mark.high:
                low, high = mark.low / factor, mark.high / factor
                raise _BadValue(f"{one / factor:g} is outside {low:g} .. {high:g}")
    if isinstance(mark, DirectionMark) and max(map(abs, value)) < mark.least:
        raise _BadValue(f"has no length; its greatest component must be at least {mark.least:g}")


def _show(value: Any) -> str:
    """Return a value of the file, short enough for a message."""
    text = str(value).lower() if isinstance(value, bool) else f"{value!r}"
    return shorten(text)


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
