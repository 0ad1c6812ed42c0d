"""Effects as text on the command line and in scenarios: NAME:PLACE:PARAMETER=VALUE,..."""

import re
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, get_type_hints

from fsw.dictionary.types import match_name
from sim.effects.catalogue import (
    PlaceField,
    catalogue,
    effect_classes_in,
    effect_name,
    parameters_of,
    place_fields_of,
    place_word,
)
from sim.effects.effect import Effect, Timed
from sim.effects.environment import PowerLoss
from sim.scenario.records import (
    TYPE_KEY,
    Findings,
    did_you_mean,
    field_keys,
    list_choices,
    list_tables,
    read_record,
    shorten,
)
from simgap.common.errors import RobotError
from simgap.common.modules import load_module
from simgap.common.toml import KeyPath, parse_toml, read_toml, toml_text

FILE_PATTERN: Final = re.compile(r"(?P<file>.+?\.py):(?P<rest>.*)", re.DOTALL)
TABLE_NAME: Final = "effect"
COMMA_PATTERN: Final = re.compile(r",(?![^\[]*\])")
"""Comma outside of brackets."""


class BadEffect(ValueError):
    """Effect that cannot be made; the message names it and says what would be right."""


def parse_effect_text(text: str, tools: Sequence[str]) -> Effect:
    """Make the effect NAME or FILE.py:CLASS:PLACE:PARAMETER=VALUE,...; BadEffect if any of it is wrong."""
    file = FILE_PATTERN.fullmatch(text)
    name, *parts = (part.strip() for part in (text if file is None else file["rest"]).split(":"))
    if file is not None:
        name = f"{file['file']}:{name}"
    kind = find_effect_class(name)
    place, said = _split(name, parts)
    known = place_fields_of(kind, tools)
    table = {**_parse_place(known, name, place), **_parse_parameters(name, said)}
    missing = [where for where in known if not where.optional and where.field not in table]
    if missing:
        raise BadEffect(
            f"effect {name}: place: {missing[0].field} is missing; there are {', '.join(missing[0].members)}"
        )
    findings = Findings(tuple(tools))
    effect = read_record(kind, table, (), findings)
    if effect is None:
        at = f"{name}:{place}" if place else name
        raise BadEffect("\n".join(f"effect {at}: {problem}" for problem in findings.problems))
    return effect


def effect_text(effect: Effect) -> str:
    """Return the text of an effect, which reads back exactly."""
    table = effect_table(effect)
    name = table.pop(TYPE_KEY)
    places = [where.field for where in place_fields_of(type(effect)) if where.field in table]
    place = ".".join(table.pop(field) for field in places)
    said = [f"{key}={list(v) if isinstance(v, tuple) else repr(v)}" for key, v in table.items()]
    return ":".join(part for part in (name, place, ",".join(said)) if part)


def find_effect_class(name: str) -> type[Effect]:
    """Return a class of effect by its name in the catalogue or by FILE.py:CLASS; BadEffect if it has none."""
    file = FILE_PATTERN.fullmatch(name)
    if file is None and not name.endswith(".py"):
        if name not in catalogue():
            close = get_close_matches(name.lower(), catalogue(), n=1)
            meant = f"did you mean {close[0]}? " if close else ""
            raise BadEffect(
                f"effect {shorten(name)!r} is not known; {meant}`marsarm dictionary --effects` lists what "
                "there is"
            )
        return catalogue()[name]
    path, wanted = (name, "") if file is None else (file["file"], file["rest"])
    return load_effect_class(path, wanted)


def read_effect(table: dict[str, Any], place: KeyPath, findings: Findings) -> Effect | None:
    """Read an effect that lasts for the whole run, or return None and report problems."""
    if not isinstance(table.get(TYPE_KEY), str):
        findings.report(
            (*place, TYPE_KEY), 'is missing; write the name of an effect, such as "coulomb-friction"'
        )
        return None
    try:
        kind = find_effect_class(table[TYPE_KEY])
    except BadEffect as error:
        findings.report((*place, TYPE_KEY), str(error))
        return None
    if issubclass(kind, Timed | PowerLoss):
        findings.report((*place, TYPE_KEY), f"{table[TYPE_KEY]} comes at a moment; write it as [[fault]]")
        return None
    rest = {key: value for key, value in table.items() if key != TYPE_KEY}
    return read_record(kind, rest, place, findings)


def read_effect_file(path: Path, tools: Sequence[str]) -> tuple[Effect, ...]:
    """Read the effects of a file, for an arm with these tools; BadEffect has a line for each problem."""
    try:
        data = read_toml(path)
    except RobotError as error:
        raise BadEffect(str(error)) from error
    findings = Findings(tuple(tools))
    for key in data:
        if key != TABLE_NAME:
            findings.report(
                (shorten(key),), f"does not belong in a file of effects; there is only [[{TABLE_NAME}]]"
            )
    found = [read_effect(table, place, findings) for place, table in list_tables(data, TABLE_NAME, findings)]
    if not data:
        findings.report((TABLE_NAME,), "is missing; the file holds no effect")
    if findings.problems:
        raise BadEffect("\n".join(f"{path}: {problem}" for problem in findings.problems))
    return tuple(effect for effect in found if effect is not None)


def effect_file_text(effects: Sequence[Effect], comments: Sequence[str]) -> str:
    """Write a file of these effects, which reads back exactly, below comments."""
    return toml_text({TABLE_NAME: [effect_table(effect) for effect in effects]}, comments)


def effect_table(effect: Effect) -> dict[str, Any]:
    """Return the table of an effect, which reads back exactly."""
    kind = type(effect)
    name = effect_name(kind)
    if catalogue().get(name) is not kind:
        name = f"{sys.modules[kind.__module__].__file__}:{kind.__name__}"
    values = [(place, getattr(effect, place.field)) for place in place_fields_of(kind)]
    words = {place.field: place_word(place, value) for place, value in values if value is not None}
    parameters = ((parameter_key(kind, p.field), getattr(effect, p.field)) for p in parameters_of(kind))
    return {TYPE_KEY: name, **words, **{key: value for key, value in parameters if value is not None}}


def effect_classes_in_file(path: str) -> tuple[type[Effect], ...]:
    """Run a Python file and return its effects; BadEffect if the file cannot be run."""
    try:
        return tuple(effect_classes_in(load_module(Path(path))))
    except RobotError as error:
        raise BadEffect(f"effect {error}") from error


def load_effect_class(path: str, name: str) -> type[Effect]:
    """Run a Python file and return its class of this name; BadEffect if that fails, or it is no effect."""
    known = [kind.__name__ for kind in effect_classes_in_file(path)]
    kind = vars(load_module(Path(path))).get(name)
    if not name:
        raise BadEffect(
            f"effect {path}: names no class; write {path}:CLASS:PLACE:PARAMETER=VALUE,...; "
            f"{list_choices(known)}"
        )
    if kind is None:
        raise BadEffect(f"effect {path}:{name}: there is no such class; {did_you_mean(name, known)}")
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise BadEffect(
            f"effect {path}:{name}: is no effect; derive it from Effect, EachCycle, EachMove or Timed of "
            f"sim.effects.effect; {list_choices(known)}"
        )
    if "__dataclass_fields__" not in vars(kind):
        raise BadEffect(
            f"effect {path}:{name}: is no dataclass; write @dataclass(frozen=True, slots=True) above it"
        )
    return kind


def parameter_key(kind: type[Effect], field: str) -> str:
    """Return the name of a parameter with its SI unit."""
    hint = get_type_hints(kind)[field]
    return next(key for key, factor in field_keys(field, hint).factors.items() if factor == 1.0)


def _split(name: str, parts: list[str]) -> tuple[str, str]:
    """Return place and parameters; either may be missing."""
    if len(parts) > 2:
        raise BadEffect(
            f"effect {name}: {shorten(':'.join(parts))} has too many colons; write {_usage(name)}"
        )
    if len(parts) == 1:
        return ("", parts[0]) if "=" in parts[0] else (parts[0], "")
    return (parts[0], parts[1]) if parts else ("", "")


def _parse_place(known: Sequence[PlaceField], name: str, text: str) -> dict[str, str]:
    """Return the fields of a place, such as arm3.z."""
    words = text.split(".") if text else []
    if len(words) > len(known):
        what = " and ".join(where.field for where in known)
        sits = f"it sits at a {what}" if known else "it has no place"
        raise BadEffect(f"effect {name}: place {shorten(text)!r} has too many words; {sits}")
    for where, word in zip(known, words, strict=False):
        if match_name(word, where.members) is None:
            raise BadEffect(
                f"effect {name}: place: {where.field} {shorten(word)!r} is not known; "
                f"{did_you_mean(word, where.members)}"
            )
    return {where.field: word for where, word in zip(known, words, strict=False)}


def _parse_parameters(name: str, text: str) -> dict[str, Any]:
    """Return parameters and values; a value is a number, a word, or numbers in brackets."""
    found: dict[str, Any] = {}
    for pair in COMMA_PATTERN.split(text) if text else ():
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not (key and equals and value):
            raise BadEffect(
                f"effect {name}: {shorten(pair)!r} is no parameter and its value; write {_usage(name)}"
            )
        if key in found:
            raise BadEffect(f"effect {name}: {key} is given twice; give it once")
        found[key] = _parse_value(name, value)
    return found


def _parse_value(name: str, text: str) -> Any:
    try:
        return parse_toml(f"value = {text}", name)["value"]
    except RobotError:
        return text


def _usage(name: str) -> str:
    return f"{name}:PLACE:PARAMETER=VALUE,..."
