"""Output of the verb `dictionary`: tables and JSON documents of channels and of effects."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from marsarm.dictionary.entries import (
    Definition,
    Dictionary,
    EvrDefinition,
    FieldDefinition,
    PacketDefinition,
)
from sim.effects.catalogue import (
    ParameterField,
    all_places,
    catalogue,
    effect_place_text,
    effect_summary,
    effect_timing,
    has_flight_parameter,
    hypotheses,
    parameters_of,
    place_fields_of,
)
from sim.effects.effect import Effect
from sim.scenario.effects import parameter_key
from simgap.common.console import plain_console


def effects_json() -> list[dict[str, Any]]:
    """Return the catalogue as a JSON document."""
    hypothesis_kinds = {hypothesis.kind for hypothesis in hypotheses()}
    return [
        {
            "name": name,
            "text": effect_summary(kind),
            "when": effect_timing(kind),
            "place_fields": [one.field for one in place_fields_of(kind)],
            "places": [text for place in all_places(kind) if (text := effect_place_text(kind, place))],
            "parameters": [_parameter_json(kind, parameter) for parameter in parameters_of(kind)],
            "in_flight_parameters": has_flight_parameter(kind),
            "is_hypothesis": kind in hypothesis_kinds,
        }
        for name, kind in catalogue().items()
    ]


def _parameter_json(kind: type[Effect], parameter: ParameterField) -> dict[str, Any]:
    spec = parameter.spec
    about = (
        {}
        if spec is None
        else {key: getattr(spec, key) for key in ("unit", "low", "high", "typical", "neutral")}
    )
    return {
        "name": parameter_key(kind, parameter.field),
        "numbers": parameter.count,
        "default": parameter.default,
        **about,
    }


def effects_table() -> None:
    """Print the catalogue: name and summary, places and timing, and parameters of each effect."""
    console = plain_console()
    for name, kind in catalogue().items():
        console.print(f"\n{name}  {effect_summary(kind)}", style="bold")
        places = place_fields_of(kind)
        if places:
            texts = [f"{one.field} ({', '.join(one.members)})" for one in places]
            console.print(f"  at {', '.join(texts)}; {effect_timing(kind)}")
        parameters = parameters_of(kind)
        if parameters:
            console.print(_effect_table(kind, parameters))


def _effect_table(kind: type[Effect], parameters: tuple[ParameterField, ...]) -> Table:
    table = Table(show_edge=False, pad_edge=False, box=None)
    for column in ("  parameter", "unit", "limits", "neutral", "typically off by", "default"):
        table.add_column(column)
    for parameter in parameters:
        spec = parameter.spec
        cells = ["", "", "", ""]
        if spec is not None:
            neutral = "" if spec.neutral is None else f"{spec.neutral:g}"
            off_by = "" if spec.neutral is None else f"{spec.typical:g}"
            cells = [spec.unit, f"{spec.low:g} .. {spec.high:g}", neutral, off_by]
        default = "" if parameter.default is None else str(parameter.default)
        table.add_row(f"  {parameter_key(kind, parameter.field)}", *cells, default)
    return table


COLUMNS: Final = ("name", "type", "unit", "limits", "default", "text")
FIELD_PATTERN: Final = re.compile(r"\{e\.(\w+)[^}]*\}")
"""Placeholder in the message of an EVR: name of the field and its format."""


def dictionary_json(dictionary: Dictionary) -> dict[str, Any]:
    """Return the dictionary as a JSON document."""
    return asdict(dictionary)


def dictionary_tables(dictionary: Dictionary) -> None:
    """Print the dictionary by section: heading, sentence and fields of each entry."""
    console = Console(highlight=False)
    for title, entries in _sections(dictionary):
        console.rule(title, align="left")
        for entry in entries:
            console.print(f"\n[bold]{escape(_heading(entry))}[/bold]  {escape(_sentence(entry))}")
            if entry.fields:
                console.print(_table(entry.fields))
    if dictionary.parameters:
        console.rule("parameters", align="left")
        console.print(_table(dictionary.parameters))


def _sections(dictionary: Dictionary) -> Iterator[tuple[str, tuple[Definition, ...]]]:
    sections: dict[str, tuple[Definition, ...]] = {
        "commands": dictionary.commands,
        "event reports": dictionary.evrs,
        "channels": dictionary.packets,
    }
    yield from ((title, entries) for title, entries in sections.items() if entries)


def _heading(entry: Definition) -> str:
    match entry:
        case EvrDefinition():
            return f"{entry.name} ({entry.severity})"
        case PacketDefinition(is_truth=True):
            return f"{entry.name} (truth: the plant's own; flight software never sees it)"
        case _:
            return entry.name


def _sentence(entry: Definition) -> str:
    text = " ".join(entry.text.split())
    if not isinstance(entry, EvrDefinition):
        return text
    response = "" if entry.response is None else f" Response: {entry.response}."
    message = FIELD_PATTERN.sub(r"{\1}", entry.message)
    return f'{text} "{message}"{response}'


def _table(fields: Iterable[FieldDefinition]) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    rows = [_cells(one) for one in fields]
    used = [k for k in range(len(COLUMNS)) if any(row[k] for row in rows)]
    for k in used:
        table.add_column(COLUMNS[k], overflow="fold")
    for row in rows:
        table.add_row(*(escape(row[k]) for k in used))
    return table


def _cells(one: FieldDefinition) -> tuple[str, ...]:
    limits = "" if one.low is None or one.high is None else f"{one.low:g} .. {one.high:g}"
    return one.name, one.type, one.unit or "", limits, _default_text(one.default), " ".join(one.text.split())


def _default_text(default: Any) -> str:
    """Format a default; "..." if it is too long for a table."""
    match default:
        case None:
            return ""
        case bool():
            return "yes" if default else "no"
        case float():
            return f"{default:.6g}"
        case list() if len(default) > 6 or any(isinstance(item, list) for item in default):
            return "..."
        case list():
            return " ".join(_default_text(item) for item in default)
        case _:
            return str(default)
