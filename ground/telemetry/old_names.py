"""Names and parameters in logs of versions 0.1 and 0.2, and how they stand today; readable until version 1.0.

No name is both an old and a new one, so a log needs no version: an old name is replaced wherever it stands.
The tables of names are in `sim/old_names.py`. Parameters of 0.1 and 0.2 have a record of tools and one of
rover parts; today both are lists, and the parameters name their drawing.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from ground.telemetry.events import CommandEntry, EvrEntry
from ground.telemetry.json_codec import record_to_json
from sim.old_names import (
    CHANNELS,
    COMMAND_FIELDS,
    EFFECT_PARAMETERS,
    EVR_FIELDS,
    EVRS,
    PARAMETERS,
    REFERENCE_FIELDS,
)
from sim.params import nominal_params

IN_TEXT: Final = {**PARAMETERS, "away_m": "standoff_m"}
"""Names in the texts of events, such as the reason of a refusal."""
IN_TEXT_PATTERN: Final = re.compile(rf"(?<![\w.])({'|'.join(map(re.escape, IN_TEXT))})(?![\w.])")


def rename_channel(topic: str, field: str) -> str:
    """Return today's name of a field of a topic."""
    return _rename_field(topic, field, CHANNELS)


def rename_evr(entry: EvrEntry) -> EvrEntry:
    """Return an event with today's names of itself, its fields and what its texts name."""
    message = _rename_in_text(entry.message)
    values = {
        _rename_field(entry.name, name, EVR_FIELDS): _rename_in_text(value)
        if isinstance(value, str)
        else value
        for name, value in entry.fields.items()
    }
    if values == entry.fields and entry.name not in EVRS:
        return entry if message == entry.message else replace(entry, message=message)
    return replace(
        entry, name=EVRS.get(entry.name, entry.name), message=message, fields_json=json.dumps(values)
    )


def rename_command(entry: CommandEntry) -> CommandEntry:
    """Return a command with today's names of its arguments and of the parameters that it sets."""
    fields = _rename_command_fields(entry.name, entry.fields)
    return entry if fields == entry.fields else replace(entry, fields_json=json.dumps(fields))


def rename_header(header: Mapping[str, str]) -> dict[str, str]:
    """Return a header with today's names and structure of parameters, reference, commands and effects.

    A part that is not JSON of the known form stays as it is; its reader says so.
    """
    parts: dict[str, Callable[[Any], Any]] = {
        "params": lambda part: _lower_names(
            _list_tools(
                {
                    group: _rename_fields(group, values, PARAMETERS) if isinstance(values, dict) else values
                    for group, values in part.items()
                }
            )
        ),
        "boot": lambda part: (
            {**part, "reference": _rename_fields("reference", part["reference"], REFERENCE_FIELDS)}
            if part.get("reference")
            else part
        ),
        "commands": lambda part: [
            {**one, "fields": _rename_command_fields(one["type"], one["fields"])} for one in part
        ],
        "effects": lambda part: [_rename_effect(text) for text in part],
    }
    return {key: _rename_json(text, parts[key]) if key in parts else text for key, text in header.items()}


def _list_tools(params: dict[str, Any]) -> dict[str, Any]:
    """Return parameters of 0.1 or 0.2 with lists of tools and rover parts; those of today stay as they are.

    Switches and titles of tools were not parameters; they are those of the nominal arm.
    """
    if not isinstance(params.get("tools"), dict):
        return params
    nominal, collision = nominal_params(), params["collision"]
    titles = {tool.name: tool.title for tool in nominal.tools}
    tools = [
        {"name": name, "title": titles[name], **tool, "geometry": collision["arm"][name]}
        for name, tool in params["tools"].items()
    ]
    links = {name: part for name, part in collision["arm"].items() if name not in params["tools"]}
    rover = [{"name": name, **part} for name, part in collision["rover"].items()]
    return {
        **params,
        "model": record_to_json(nominal.model),
        "tools": tools,
        "switches": record_to_json(nominal.switches),
        "collision": {**collision, "arm": links, "rover": rover},
    }


def _lower_names(params: dict[str, Any]) -> dict[str, Any]:
    """Return parameters with names of tools and switches in small letters; they were capitals once."""
    named = {"tools": ("name",), "switches": ("name", "tool"), "teach": ("tool",)}
    lower = {
        place: [{**one, **{key: one[key].lower() for key in keys}} for one in params[place]]
        for place, keys in named.items()
    }
    return {**params, **lower}


def _rename_json(text: str, rename: Callable[[Any], Any]) -> str:
    """Rename in a JSON text; a text in which nothing is renamed keeps its bytes."""
    try:
        before = json.loads(text)
        after = rename(before)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return text
    return text if after == before else json.dumps(after)


def _rename_field(owner: str, field: str, names: Mapping[str, str]) -> str:
    return _field_of(names.get(f"{owner}.{field}", f".{field}"))


def _rename_fields(owner: str, values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {_rename_field(owner, name, names): value for name, value in values.items()}


def _rename_command_fields(command: str, values: Mapping[str, Any]) -> dict[str, Any]:
    renamed = _rename_fields(command, values, COMMAND_FIELDS)
    if command == "SetParam" and isinstance(renamed.get("name"), str):
        renamed["name"] = PARAMETERS.get(renamed["name"], renamed["name"])
    return renamed


def _rename_effect(text: str) -> str:
    """Rename the parameters in the text of an effect, NAME:PLACE:PARAMETER=VALUE,..."""
    name = text.split(":")[0]
    for old, new in EFFECT_PARAMETERS.items():
        effect, field = old.split(".")
        if effect == name:
            text = re.sub(rf"(?<=[:,]){field}=", f"{_field_of(new)}=", text)
    return text


def _field_of(dotted: str) -> str:
    return dotted.rsplit(".", 1)[1]


def _rename_in_text(text: str) -> str:
    return IN_TEXT_PATTERN.sub(lambda found: IN_TEXT[found[0]], text)
