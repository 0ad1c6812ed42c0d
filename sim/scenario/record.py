"""A table of a scenario file as any frozen dataclass: names, units, types and limits by reflection."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import IntEnum
from types import UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from fsw.dictionary.types import Limits
from sim.scenario.names import Words, did_you_mean, one_of, spoken, words_of
from sim.scenario.toml_lines import Place

T = TypeVar("T")
Choices = Mapping[str, tuple[str, ...]]
"""By the name of a field: what its text may be."""

NO_CHOICES: Final[Choices] = {}
TYPE: Final = "type"
"""The key that says which dataclass a table is."""


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """What is wrong on a line of a file, and what would be right."""

    line: int
    """From 1; 0 is of the whole file."""
    text: str


@dataclass(frozen=True, slots=True)
class Findings:
    """The problems of a file, found one by one."""

    lines: Mapping[Place, int]
    problems: list[Problem] = field(default_factory=list)

    def say(self, place: Place, text: str) -> None:
        """Note what is wrong with the value at a place."""
        known = next(place[:k] for k in range(len(place), -1, -1) if place[:k] in self.lines)
        self.problems.append(Problem(self.lines[known], text))


class _Wrong(Exception):
    """A value that its field cannot take."""


def record_of(
    kind: type[T], table: dict[str, Any], place: Place, findings: Findings, choices: Choices = NO_CHOICES
) -> T | None:
    """The dataclass that a table says, all of its fields but those that are not the file's to say.

    None if anything is wrong with it, which is then among the findings.
    """
    before = len(findings.problems)
    hints = get_type_hints(kind, include_extras=True)
    words = {f.name: words_of(f.name, _plain(hints[f.name])) for f in fields(kind)}  # type: ignore[arg-type]
    said = _keys(list(words.values()), table, place, findings)
    values: dict[str, Any] = {}
    for f in fields(kind):  # type: ignore[arg-type]
        key = said.get(f.name)
        if key in words[f.name].factors:
            values[f.name] = _value(
                hints[f.name],
                table[key],
                (*place, key),
                findings,
                words[f.name].factors[key],
                choices.get(f.name),
            )
        elif key is None and f.default is MISSING and f.default_factory is MISSING:
            findings.say(place, f"{words[f.name]}: is missing")
    if len(findings.problems) > before:
        return None
    try:
        return kind(**values)
    except ValueError as error:  # fields that do not go together
        findings.say(place, str(error))
        return None


def table_of(value: Any, place: Place, findings: Findings) -> dict[str, Any] | None:
    """The value as a table, or None and a problem."""
    if isinstance(value, dict):
        return value
    findings.say(place, f"{place[-1]}: {_shown(value)} is no table; write [{place[-1]}] and its keys below")
    return None


def kind_of(
    kinds: Mapping[str, type[T]], table: dict[str, Any], place: Place, findings: Findings
) -> type[T] | None:
    """Which of these dataclasses a table is, by its type."""
    if TYPE not in table:
        findings.say(place, f"{TYPE}: is missing; {one_of(kinds)}")
        return None
    name = table[TYPE]
    if isinstance(name, str) and name in kinds:
        return kinds[name]
    findings.say((*place, TYPE), f"{TYPE}: {_shown(name)} is not known; {did_you_mean(str(name), kinds)}")
    return None


def _keys(words: list[Words], table: dict[str, Any], place: Place, findings: Findings) -> dict[str, str]:
    """The key that is there for each field; one that does not say its field rightly is a problem."""
    said: dict[str, str] = {}
    for key in table:
        at = (*place, key)
        meant = next((w for w in words if key in w.factors), None) or _without_unit(key, words)
        if meant is None:
            findings.say(at, f"{spoken(key)}: is not known here; {did_you_mean(key, map(str, words))}")
        elif meant.field in said:
            findings.say(at, f"{key}: {said[meant.field]} says the same; give one of the two")
        else:
            said[meant.field] = key
            if key not in meant.factors:
                findings.say(at, f"{key}: has {'no' if key == meant.stem else 'another'} unit; write {meant}")
    return said


def _without_unit(key: str, words: list[Words]) -> Words | None:
    """The field that a key is about that lacks its unit or has one that is not its own."""
    with_unit = [w for w in words if w.stem not in w.factors]
    return next((w for w in with_unit if key == w.stem or key.startswith(f"{w.stem}_")), None)


def _value(
    kind: Any, value: Any, place: Place, findings: Findings, factor: float, choices: tuple[str, ...] | None
) -> Any:
    plain = _plain(kind)
    if is_dataclass(plain):
        table = table_of(value, place, findings)
        return None if table is None else record_of(plain, table, place, findings)  # type: ignore[arg-type]
    try:
        read = _read(plain, value, factor, choices)
        for limits in getattr(kind, "__metadata__", ()):
            _within(limits, read, factor)
    except _Wrong as wrong:
        findings.say(place, f"{place[-1]}: {wrong}")
        return None
    return read


def _read(kind: Any, value: Any, factor: float, choices: tuple[str, ...] | None) -> Any:
    if kind is float:
        return _number(value, factor)
    if kind is bool:
        return _typed(bool, value, "true or false")
    if kind is int:
        return _typed(int, value, "a whole number")
    if get_origin(kind) is Literal or choices is not None:
        return _chosen(get_args(kind) if choices is None else choices, value)
    if kind is str:
        return _typed(str, value, "text in quotes")
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return kind[_chosen(tuple(member.name.lower() for member in kind), value).upper()]
    if get_origin(kind) is tuple:
        return _items(get_args(kind), value, factor)
    raise TypeError(f"a scenario file has no words for {kind}")


def _items(kinds: tuple[Any, ...], value: Any, factor: float) -> tuple[Any, ...]:
    """So many values, or one and more where the type ends in three dots."""
    if kinds[-1] is Ellipsis:
        if not isinstance(value, list) or not value:
            raise _Wrong(f"{_shown(value)} is not one value or more in brackets")
        kinds = kinds[:1] * len(value)
    elif not isinstance(value, list) or len(value) != len(kinds):
        raise _Wrong(
            f"{_shown(value)} is not {len(kinds)} {'flags' if kinds[0] is bool else 'numbers'} in brackets"
        )
    return tuple(_read(kind, item, factor, None) for kind, item in zip(kinds, value, strict=True))


def _plain(kind: Any) -> Any:
    """The type without its limits, and without None: what is left out has its default."""
    while get_origin(kind) in (Annotated, UnionType, Union):
        kind = get_args(kind)[0]
    return kind


def _number(value: Any, factor: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _Wrong(f"{_shown(value)} is not a number")
    try:
        number = float(value) * factor
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise _Wrong(f"{_shown(value)} is not a finite number")
    return number


def _typed(kind: type, value: Any, what: str) -> Any:
    if type(value) is not kind:
        raise _Wrong(f"{_shown(value)} is not {what}")
    return value


def _chosen(known: tuple[str, ...], value: Any) -> str:
    if isinstance(value, str) and value in known:
        return value
    raise _Wrong(f"{_shown(value)} is not known; {did_you_mean(str(value), known)}")


def _within(limits: Any, value: Any, factor: float) -> None:
    if not isinstance(limits, Limits):
        return
    for one in value if isinstance(value, tuple) else (value,):
        if not limits.low <= one <= limits.high:
            low, high = limits.low / factor, limits.high / factor
            raise _Wrong(f"{one / factor:g} is outside {low:g} .. {high:g}")


def _shown(value: Any) -> str:
    """A value of the file, short enough for a sentence."""
    text = str(value).lower() if isinstance(value, bool) else f"{value!r}"
    return spoken(text)
