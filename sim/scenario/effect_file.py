"""Files of effects, with the tables [[effect]] of a scenario."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from sim.effects.catalogue import catalogue, effect_name, parameters_of, place_fields_of, place_word
from sim.effects.effect import Effect
from sim.scenario.effects import BadEffect, parameter_key
from sim.scenario.names import shorten
from sim.scenario.toml_lines import NotToml, parse_toml
from sim.scenario.toml_record import TYPE_KEY, Findings
from sim.scenario.toml_tables import list_tables, read_effect
from sim.text_file import UnreadableText, read_text

TABLE_NAME: Final = "effect"


def read_effect_file(path: Path, tools: Sequence[str]) -> tuple[Effect, ...]:
    """Read the effects of a file, for an arm with these tools.

    Raises:
        BadEffect: the file cannot be read or is wrong; the message has a line for each problem.
    """
    try:
        data, lines = parse_toml(read_text(path))
    except UnreadableText as error:
        raise BadEffect(f"{path}: {error}") from error
    except NotToml as error:
        raise BadEffect(f"{path}:{error.line}: {error}") from error
    findings = Findings(lines, tuple(tools))
    for key in data:
        if key != TABLE_NAME:
            findings.report(
                (key,),
                f"{shorten(key)}: does not belong in a file of effects; there is only [[{TABLE_NAME}]]",
            )
    found = [read_effect(table, place, findings) for place, table in list_tables(data, TABLE_NAME, findings)]
    if findings.problems:
        problem_lines = [f"{path}:{problem.line}: {problem.text}" for problem in sorted(findings.problems)]
        raise BadEffect("\n".join(problem_lines))
    return tuple(effect for effect in found if effect is not None)


def effect_file_text(effects: Sequence[Effect], comments: Sequence[str]) -> str:
    """Write a file of these effects, which reads back exactly, below comments.

    Args:
        comments: Comments, one a line.
    """
    lines = [f"# {line}" for line in comments]
    for effect in effects:
        lines += [
            "",
            f"[[{TABLE_NAME}]]",
            *(f"{key} = {_format_toml(value)}" for key, value in effect_table(effect).items()),
        ]
    return "\n".join([*lines, ""])


def effect_table(effect: Effect) -> dict[str, Any]:
    """Return the table of an effect, which reads back exactly."""
    kind = type(effect)
    name = effect_name(kind)
    if catalogue().get(name) is not kind:
        name = f"{sys.modules[kind.__module__].__file__}:{kind.__name__}"
    places = {place.field: getattr(effect, place.field) for place in place_fields_of(kind)}
    words = {field: _place_name(kind, field, value) for field, value in places.items() if value is not None}
    values = {p.field: getattr(effect, p.field) for p in parameters_of(kind)}
    numbers = {parameter_key(kind, field): value for field, value in values.items() if value is not None}
    return {TYPE_KEY: name, **words, **numbers}


def _place_name(kind: type[Effect], field: str, value: Any) -> str:
    return place_word(next(place for place in place_fields_of(kind) if place.field == field), value)


def _format_toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_format_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
