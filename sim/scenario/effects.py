"""Effects as the command line and scenario files write them: NAME:PLACE:PARAMETER=VALUE,..."""

import re
import sys
import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, Final, get_type_hints

from sim.effects.catalogue import catalogue
from sim.effects.describe import name_of, parameters_of, place_named, places_of
from sim.effects.effect import Effect
from sim.scenario.names import did_you_mean, spoken, words_of
from sim.scenario.outside import NotAnEffect, effect_class
from sim.scenario.record import Findings, record_of

FILE: Final = re.compile(r"(?P<file>.+?\.py):(?P<rest>.*)", re.DOTALL)
COMMA: Final = re.compile(r",(?![^\[]*\])")
"""Not one between brackets."""


class BadEffect(ValueError):
    """An effect that cannot be switched on; the message names it and says what would be right."""


def effect_from(text: str) -> Effect:
    """The effect that a text says, of the catalogue or from a file: FILE.py:CLASS:PLACE:PARAMETER=VALUE,...

    Raises:
        BadEffect: there is none of this name, or its place or its parameters are wrong.
    """
    file = FILE.fullmatch(text)
    name, *parts = (part.strip() for part in (text if file is None else file["rest"]).split(":"))
    if file is not None:
        name = f"{file['file']}:{name}"
    kind = kind_named(name)
    place, said = _split(name, parts)
    table = {**_placed(kind, name, place), **_pairs(name, said)}
    missing = [where for where in places_of(kind) if not where.optional and where.field not in table]
    if missing:
        raise BadEffect(
            f"effect {name}: place: {missing[0].field} is missing; there are {', '.join(missing[0].members)}"
        )
    return effect_of(kind, f"{name}:{place}" if place else name, table)


def kind_named(name: str) -> type[Effect]:
    """The class of an effect by its name in the catalogue, or as FILE.py:CLASS.

    Raises:
        BadEffect: there is none.
    """
    file = FILE.fullmatch(name)
    if file is None and not name.endswith(".py"):
        if name not in catalogue():
            close = get_close_matches(name.lower(), catalogue(), n=1)
            meant = f"did you mean {close[0]}? " if close else ""
            raise BadEffect(
                f"effect {spoken(name)!r} is not known; {meant}`marsarm effects` lists what there is"
            )
        return catalogue()[name]
    path, wanted = (name, "") if file is None else (file["file"], file["rest"])
    try:
        return effect_class(path, wanted)
    except NotAnEffect as error:
        raise BadEffect(str(error)) from error


def effect_of(kind: type[Effect], name: str, table: Mapping[str, Any]) -> Effect:
    """The effect that a table of its fields says.

    Raises:
        BadEffect: a field is missing, is not known, or has a value that it cannot have.
    """
    findings = Findings({(): 0})
    effect = record_of(kind, dict(table), (), findings)
    if effect is None:
        raise BadEffect("\n".join(f"effect {name}: {problem.text}" for problem in findings.problems))
    return effect


def spec_of(effect: Effect) -> str:
    """The text that says this effect, exactly."""
    kind = type(effect)
    name = name_of(kind)
    if catalogue().get(name) is not kind:
        name = f"{sys.modules[kind.__module__].__file__}:{kind.__name__}"
    place = place_named(kind, {where.field: getattr(effect, where.field) for where in places_of(kind)})
    said = []
    for parameter in parameters_of(kind):
        value = getattr(effect, parameter.field)
        if value is not None:
            key = written(kind, parameter.field)
            said.append(f"{key}={list(value) if isinstance(value, tuple) else repr(value)}")
    return ":".join(part for part in (name, place, ",".join(said)) if part)


def written(kind: type[Effect], field: str) -> str:
    """How a parameter is written in SI units."""
    hint = get_type_hints(kind)[field]
    return next(key for key, factor in words_of(field, hint).factors.items() if factor == 1.0)


def _split(name: str, parts: list[str]) -> tuple[str, str]:
    """Place and parameters; either may be missing."""
    if len(parts) > 2:
        raise BadEffect(f"effect {name}: {spoken(':'.join(parts))} has too many colons; write {_form(name)}")
    if len(parts) == 1:
        return ("", parts[0]) if "=" in parts[0] else (parts[0], "")
    return (parts[0], parts[1]) if parts else ("", "")


def _placed(kind: type[Effect], name: str, text: str) -> dict[str, str]:
    """The fields of a place: arm3.z."""
    words, known = text.split(".") if text else [], places_of(kind)
    if len(words) > len(known):
        what = " and ".join(where.field for where in known)
        sits = f"it sits at a {what}" if known else "it has no place"
        raise BadEffect(f"effect {name}: place {spoken(text)!r} has too many words; {sits}")
    for where, word in zip(known, words, strict=False):
        if word not in where.members:
            raise BadEffect(
                f"effect {name}: place: {where.field} {spoken(word)!r} is not known; "
                f"{did_you_mean(word, where.members)}"
            )
    return {where.field: word for where, word in zip(known, words, strict=False)}


def _pairs(name: str, text: str) -> dict[str, Any]:
    """Parameters and values; a value is a number, a word, or numbers in brackets."""
    found: dict[str, Any] = {}
    for pair in COMMA.split(text) if text else ():
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not (key and equals and value):
            raise BadEffect(
                f"effect {name}: {spoken(pair)!r} is no parameter and its value; write {_form(name)}"
            )
        if key in found:
            raise BadEffect(f"effect {name}: {key} is given twice; give it once")
        found[key] = _value(value)
    return found


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _form(name: str) -> str:
    return f"{name}:PLACE:PARAMETER=VALUE,..."
