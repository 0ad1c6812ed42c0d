"""Tables of flight parameters, as they stand in a TOML file; all errors are in one message."""

import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import asdict
from datetime import date, time
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits
from sim.text_file import UnreadableText, load_toml, read_text

WANTED: Final = {
    "missing": "is missing",
    "dataclass": "must be a table",
    "model": "must be a table",
    "dict": "must be a table",
    "float": "must be a number",
    "finite_number": "must be a finite number",
    "int": "must be a whole number",
    "bool": "must be true or false",
    "string": "must be text in quotes",
    "tuple": "must be values in brackets",
    "list": "must be values in brackets",
}
"""What a value must be, by the start of the kind of pydantic's error."""
NAMED: Final = ("tools", "switches", "collision.rover")
"""Tables of a parameter file whose keys are names of records."""


class BadParams(ValueError):
    """Parameter file that is refused; the message names every wrong field."""


def params_table(params: Params) -> dict[str, Any]:
    """Return parameters as tables, as they stand in a TOML file: records with a name by their names."""
    table = asdict(params)
    for place in NAMED:
        owner, key = _owner(table, place)
        owner[key] = {record.pop("name"): record for record in owner[key]}
    table["switches"] = {name: record["tool"] for name, record in table["switches"].items()}
    return table


def check_params(params: Params, name: str) -> None:
    """Check that flight software accepts these parameters.

    Raises:
        BadParams: a value is wrong; the message names all that are.
    """
    _refuse(name, check_limits(params))
    _refuse(name, check_arm(params))


def read_params_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file of parameters as a table.

    Raises:
        BadParams: the file cannot be read.
    """
    try:
        return load_toml(read_text(path))
    except UnreadableText as error:
        raise BadParams(f"{path}: {error}") from error
    except ValueError as error:
        raise BadParams(f"{path}: is not TOML: {error}") from error


def merge_tables(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return a table with the values of another one over it."""
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = merge_tables(base[key], value) if both else value
    return merged


def params_from_table(table: dict[str, Any], name: str) -> Params:
    """Make parameters of a table, as a TOML file has it.

    Raises:
        BadParams: names or values are wrong; the message names all of them.
    """
    _refuse(name, _find_dates(table))
    listed = _list_named(table)
    try:
        params = _ADAPTER.validate_json(json.dumps(listed), strict=True, extra="forbid")
    except ValidationError as error:
        lines = [f"{name}: {_place(table, e['loc'])}: {describe_error(e)}" for e in error.errors()]
        raise BadParams("\n".join(lines)) from error
    check_params(params, name)
    return params


def _list_named(table: dict[str, Any]) -> dict[str, Any]:
    """Replace tables of named records by lists of them, in the order of the file."""
    listed = deepcopy(table)
    for place in NAMED:
        owner, key = _owner(listed, place)
        if isinstance(owner.get(key), dict):
            owner[key] = [_named_record(place, name, value) for name, value in owner[key].items()]
    return listed


def _owner(table: dict[str, Any], place: str) -> tuple[dict[str, Any], str]:
    """Return the table that holds the last key of a dotted place, and that key."""
    *path, key = place.split(".")
    for name in path:
        inner = table.get(name)
        table = inner if isinstance(inner, dict) else {}
    return table, key


def _named_record(place: str, name: str, value: Any) -> Any:
    if place == "switches":
        return {"name": name, "tool": value}
    if not isinstance(value, dict):
        return value
    if place == "tools":
        return {"title": name.replace("_", " "), **value, "name": name}
    return {**value, "name": name}


def _place(table: dict[str, Any], location: tuple[int | str, ...]) -> str:
    """Return the dotted place of an error, with the names of named records in place of their indices."""
    names = [str(key) for key in location]
    for place in NAMED:
        depth = place.count(".") + 1
        owner, key = _owner(table, place)
        if names[:depth] == place.split(".") and len(names) > depth and isinstance(owner.get(key), dict):
            names[depth] = list(owner[key])[int(names[depth])]
    return ".".join(names)


def _refuse(name: str, problems: Iterator[str]) -> None:
    lines = [f"{name}: {problem}" for problem in problems]
    if lines:
        raise BadParams("\n".join(lines))


def describe_error(error: Any) -> str:
    """Return an error, as pydantic lists it, in words of this project."""
    kind, context = error["type"], error.get("ctx", {})
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        return "is not a parameter"
    if kind in ("too_short", "too_long"):
        wanted = context.get("min_length", context.get("max_length"))
        return f"has {context['actual_length']} values; {wanted} are right"
    if kind == "literal_error":
        return f"{error['input']!r} is not known; there are {context['expected']}"
    wanted = next((text for start, text in WANTED.items() if kind.startswith(start)), None)
    return f"has a wrong value ({kind})" if wanted is None else wanted


def _find_dates(value: Any, place: str = "") -> Iterator[str]:
    """List problems with dates and times, which TOML has and no parameter is."""
    if isinstance(value, date | time):
        yield f"{place}: {value} is a date or a time; no parameter is one"
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _find_dates(item, f"{place}.{key}" if place else str(key))


_ADAPTER = TypeAdapter(Params)
