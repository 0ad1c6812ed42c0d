"""Output of the verb `dictionary`: tables and JSON documents of channels and of effects."""

import re
from collections.abc import Iterable
from typing import Any, Final

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
from simgap.common.report import Emphasis, ReportTable


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


def effects_parts() -> list[Emphasis | str | ReportTable]:
    """Show the catalogue: name and summary, places and timing, and parameters of each effect."""
    parts: list[Emphasis | str | ReportTable] = []
    for name, kind in catalogue().items():
        parts.append(Emphasis(f"\n{name}  {effect_summary(kind)}"))
        places = [f"{one.field} ({', '.join(one.members)})" for one in place_fields_of(kind)]
        if places:
            parts.append(f"  at {', '.join(places)}; {effect_timing(kind)}")
        if parameters := parameters_of(kind):
            head = ("parameter", "unit", "limits", "neutral", "typically off by", "default")
            parts.append(ReportTable(head, [_parameter_cells(kind, one) for one in parameters]))
    return parts


def _parameter_cells(kind: type[Effect], parameter: ParameterField) -> tuple[str, ...]:
    spec, cells = parameter.spec, ["", "", "", ""]
    if spec is not None:
        cells = [spec.unit, f"{spec.low:g} .. {spec.high:g}", "", ""]
        if spec.neutral is not None:
            cells[2:] = [f"{spec.neutral:g}", f"{spec.typical:g}"]
    default = "" if parameter.default is None else str(parameter.default)
    return (parameter_key(kind, parameter.field), *cells, default)


COLUMNS: Final = ("name", "type", "unit", "limits", "default", "text")
FIELD_PATTERN: Final = re.compile(r"\{e\.(\w+)[^}]*\}")
"""Placeholder in the message of an EVR: name of the field and its format."""


def dictionary_parts(dictionary: Dictionary) -> list[Emphasis | str | ReportTable]:
    """Show the dictionary by section: heading, sentence and fields of each entry."""
    sections: dict[str, tuple[Definition, ...]] = {
        "commands": dictionary.commands,
        "event reports": dictionary.evrs,
        "channels": dictionary.packets,
    }
    parts: list[Emphasis | str | ReportTable] = []
    for title, entries in sections.items():
        parts += [Emphasis(f"\n{title}")] if entries else []
        for entry in entries:
            parts.append(f"\n{_heading(entry)}: {_sentence(entry)}")
            parts += [_table(entry.fields)] if entry.fields else []
    if dictionary.parameters:
        parts += [Emphasis("\nparameters"), _table(dictionary.parameters)]
    return parts


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


def _table(fields: Iterable[FieldDefinition]) -> ReportTable:
    """Make a table of the columns that hold anything."""
    rows = [_cells(one) for one in fields]
    used = [k for k in range(len(COLUMNS)) if any(row[k] for row in rows)]
    return ReportTable([COLUMNS[k] for k in used], [[row[k] for k in used] for row in rows])


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
