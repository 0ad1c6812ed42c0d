"""Effects in a file of their own, in the tables of a scenario: [[effect]]."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from sim.effects.catalogue import catalogue
from sim.effects.describe import name_of, parameters_of, places_of
from sim.effects.effect import Effect
from sim.scenario.effects import BadEffect, written
from sim.scenario.names import spoken
from sim.scenario.record import TYPE, Findings
from sim.scenario.tables import effect_of, tables
from sim.scenario.toml_lines import NotToml, parsed

LIST: Final = "effect"


def effects_in(path: Path) -> tuple[Effect, ...]:
    """The effects that a file says.

    Raises:
        BadEffect: it cannot be read, or anything in it is wrong; a line of the message for each.
    """
    if path.exists() and not path.is_file():
        raise BadEffect(f"{path}: is no regular file; give the path of a .toml file")
    try:
        data, lines = parsed(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise BadEffect(f"{path}: cannot be read ({error.strerror})") from error
    except NotToml as error:
        raise BadEffect(f"{path}:{error.line}: {error}") from error
    except ValueError as error:
        raise BadEffect(f"{path}: cannot be read as text ({error})") from error
    findings = Findings(lines)
    for key in data:
        if key != LIST:
            findings.say((key,), f"{spoken(key)}: is not of a file of effects; there is only [[{LIST}]]")
    found = [effect_of(table, place, findings) for place, table in tables(data, LIST, findings)]
    if findings.problems:
        told = [f"{path}:{problem.line}: {problem.text}" for problem in sorted(findings.problems)]
        raise BadEffect("\n".join(told))
    return tuple(effect for effect in found if effect is not None)


def file_text(effects: Sequence[Effect], said: Sequence[str]) -> str:
    """The file that says these effects exactly, under what is to be said of them, a comment a line."""
    lines = [f"# {line}" for line in said]
    for effect in effects:
        lines += ["", f"[[{LIST}]]", *(f"{key} = {_toml(value)}" for key, value in table_of(effect).items())]
    return "\n".join([*lines, ""])


def table_of(effect: Effect) -> dict[str, Any]:
    """The table that says this effect exactly."""
    kind = type(effect)
    name = name_of(kind)
    if catalogue().get(name) is not kind:
        name = f"{sys.modules[kind.__module__].__file__}:{kind.__name__}"
    places = {where.field: getattr(effect, where.field) for where in places_of(kind)}
    words = {field: _word(kind, field, value) for field, value in places.items() if value is not None}
    values = {p.field: getattr(effect, p.field) for p in parameters_of(kind)}
    numbers = {written(kind, field): value for field, value in values.items() if value is not None}
    return {TYPE: name, **words, **numbers}


def _word(kind: type[Effect], field: str, value: Any) -> str:
    members = next(where.members for where in places_of(kind) if where.field == field)
    return next(name for name, member in members.items() if member == value)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
