"""Frozen dataclasses from tables of a scenario file: names, units, types and limits by reflection."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import IntEnum
from types import UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from fsw.dictionary.types import DirectionMark, Limits, match_name, names_tool
from sim.scenario.names import FieldKeys, did_you_mean, field_keys, list_choices, shorten
from sim.scenario.toml_lines import TomlPath

T = TypeVar("T")
Choices = Mapping[str, tuple[str, ...]]
"""Allowed texts, by name of a field."""

NO_CHOICES: Final[Choices] = {}
TYPE_KEY: Final = "type"
"""Key that names the dataclass of a table."""


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """Problem on a line of a file, and what would be right."""

    line: int
    """Line from 1; 0 means the whole file."""
    text: str


@dataclass(frozen=True, slots=True)
class Findings:
    """Problems of a file, collected while it is read."""

    lines: Mapping[TomlPath, int]
    tools: tuple[str, ...] = ()
    """Names of the tools of the arm; none if the file names no tool."""
    problems: list[Problem] = field(default_factory=list)

    def report(self, place: TomlPath, text: str) -> None:
        """Add a problem with the value at a place."""
        known = next(place[:k] for k in range(len(place), -1, -1) if place[:k] in self.lines)
        self.problems.append(Problem(self.lines[known], text))


class _BadValue(Exception):
    """Value that its field refuses."""


def read_record(
    kind: type[T], table: dict[str, Any], place: TomlPath, findings: Findings, choices: Choices = NO_CHOICES
) -> T | None:
    """Read a table as a dataclass, with those of its fields that a file may set.

    Returns:
        The dataclass, or None if there are problems, which are added to `findings`.
    """
    before = len(findings.problems)
    hints = get_type_hints(kind, include_extras=True)
    words = {f.name: field_keys(f.name, _bare_type(hints[f.name])) for f in fields(kind)}  # type: ignore[arg-type]
    said = _match_keys(list(words.values()), table, place, findings)
    values: dict[str, Any] = {}
    for f in fields(kind):  # type: ignore[arg-type]
        key = said.get(f.name)
        if key in words[f.name].factors:
            values[f.name] = _read_value(
                hints[f.name],
                table[key],
                (*place, key),
                findings,
                words[f.name].factors[key],
                findings.tools if names_tool(hints[f.name]) else choices.get(f.name),
            )
        elif key is None and f.default is MISSING and f.default_factory is MISSING:
            findings.report(place, f"{words[f.name]}: is missing")
    if len(findings.problems) > before:
        return None
    try:
        return kind(**values)
    except ValueError as error:  # fields that contradict each other
        findings.report(place, str(error))
        return None


def require_table(value: Any, place: TomlPath, findings: Findings) -> dict[str, Any] | None:
    """Return the value as a table, or None and a problem."""
    if isinstance(value, dict):
        return value
    findings.report(place, f"{place[-1]}: {_show(value)} is no table; write [{place[-1]}] and its keys below")
    return None


def read_kind(
    kinds: Mapping[str, type[T]], table: dict[str, Any], place: TomlPath, findings: Findings
) -> type[T] | None:
    """Return the dataclass that a table names as its type, or None and a problem."""
    if TYPE_KEY not in table:
        findings.report(place, f"{TYPE_KEY}: is missing; {list_choices(kinds)}")
        return None
    name = table[TYPE_KEY]
    if isinstance(name, str) and name in kinds:
        return kinds[name]
    findings.report(
        (*place, TYPE_KEY), f"{TYPE_KEY}: {_show(name)} is not known; {did_you_mean(name, kinds)}"
    )
    return None


def _match_keys(
    words: list[FieldKeys], table: dict[str, Any], place: TomlPath, findings: Findings
) -> dict[str, str]:
    """Find the key of each field; report unknown keys, wrong units and duplicates."""
    said: dict[str, str] = {}
    for key in table:
        at = (*place, key)
        meant = next((w for w in words if key in w.factors), None) or _without_unit(key, words)
        if meant is None:
            findings.report(at, f"{shorten(key)}: is not known here; {did_you_mean(key, map(str, words))}")
        elif meant.field in said:
            findings.report(at, f"{key}: {said[meant.field]} sets the same field; give one of the two")
        else:
            said[meant.field] = key
            if key not in meant.factors:
                findings.report(
                    at, f"{key}: has {'no' if key == meant.stem else 'another'} unit; write {meant}"
                )
    return said


def _without_unit(key: str, words: list[FieldKeys]) -> FieldKeys | None:
    """Find the field of a key whose unit is missing or wrong."""
    with_unit = [w for w in words if w.stem not in w.factors]
    return next((w for w in with_unit if key == w.stem or key.startswith(f"{w.stem}_")), None)


def _read_value(
    kind: Any, value: Any, place: TomlPath, findings: Findings, factor: float, choices: tuple[str, ...] | None
) -> Any:
    plain = _bare_type(kind)
    if is_dataclass(plain):
        table = require_table(value, place, findings)
        return None if table is None else read_record(plain, table, place, findings)  # type: ignore[arg-type]
    try:
        read = _convert_value(plain, value, factor, choices)
        for mark in getattr(kind, "__metadata__", ()):
            _check_limits(mark, read, factor)
            if isinstance(mark, DirectionMark) and max(map(abs, read)) < mark.least:
                raise _BadValue(f"has no length; its greatest component must be at least {mark.least:g}")
    except _BadValue as wrong:
        findings.report(place, f"{place[-1]}: {wrong}")
        return None
    return read


def _convert_value(kind: Any, value: Any, factor: float, choices: tuple[str, ...] | None) -> Any:
    if kind is float:
        return _read_number(value, factor)
    if kind is bool:
        return _check_type(bool, value, "true or false")
    if kind is int:
        return _check_type(int, value, "a whole number")
    if get_origin(kind) is Literal or choices is not None:
        return _match_choice(get_args(kind) if choices is None else choices, value)
    if kind is str:
        return _check_type(str, value, "text in quotes")
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return kind[_match_choice(tuple(member.name.lower() for member in kind), value).upper()]
    if get_origin(kind) is tuple:
        return _read_items(get_args(kind), value, factor)
    raise TypeError(f"a scenario file cannot hold a {kind}")


def _read_items(kinds: tuple[Any, ...], value: Any, factor: float) -> tuple[Any, ...]:
    """Read a fixed number of values, or one or more if the type ends in three dots."""
    if kinds[-1] is Ellipsis:
        if not isinstance(value, list) or not value:
            raise _BadValue(f"{_show(value)} is not one value or more in brackets")
        kinds = kinds[:1] * len(value)
    elif not isinstance(value, list) or len(value) != len(kinds):
        raise _BadValue(
            f"{_show(value)} is not {len(kinds)} {'flags' if kinds[0] is bool else 'numbers'} in brackets"
        )
    return tuple(_convert_value(kind, item, factor, None) for kind, item in zip(kinds, value, strict=True))


def _bare_type(kind: Any) -> Any:
    """Return the type without limits and without None; a missing value has its default."""
    while get_origin(kind) in (Annotated, UnionType, Union):
        kind = get_args(kind)[0]
    return kind


def _read_number(value: Any, factor: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _BadValue(f"{_show(value)} is not a number")
    try:
        number = float(value) * factor
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise _BadValue(f"{_show(value)} is not a finite number")
    return number


def _check_type(kind: type, value: Any, what: str) -> Any:
    if type(value) is not kind:
        raise _BadValue(f"{_show(value)} is not {what}")
    return value


def _match_choice(known: tuple[str, ...], value: Any) -> str:
    name = match_name(value, known)
    if name is None:
        raise _BadValue(f"{_show(value)} is not known; {did_you_mean(value, known)}")
    return name


def _check_limits(limits: Any, value: Any, factor: float) -> None:
    if not isinstance(limits, Limits):
        return
    for one in value if isinstance(value, tuple) else (value,):
        if not limits.low <= one <= limits.high:
            low, high = limits.low / factor, limits.high / factor
            raise _BadValue(f"{one / factor:g} is outside {low:g} .. {high:g}")


def _show(value: Any) -> str:
    """Return a value of the file, short enough for a message."""
    text = str(value).lower() if isinstance(value, bool) else f"{value!r}"
    return shorten(text)
