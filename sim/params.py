"""Tables of flight parameters, as they stand in a TOML file; all errors are in one message."""

import json
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import asdict
from datetime import date, time
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits
from simgap.common.errors import RobotError
from simgap.common.toml import KeyPath, describe_fault, key_path, read_toml, toml_text

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


def params_toml(base: Params, params: Params, comments: Sequence[str]) -> str:
    """Write the parameters that differ from `base` as TOML, below comment lines, with their drawing."""
    table = params_table(params)
    return toml_text(_changed_values(params_table(base), table) | {"model": table["model"]}, comments)


def _changed_values(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    changed: dict[str, Any] = {}
    for key, value in new.items():
        if isinstance(value, dict):
            if inner := _changed_values(old.get(key, {}), value):
                changed[key] = inner
        elif key not in old or value != old[key]:
            changed[key] = value
    return changed


def check_params(params: Params, name: str) -> None:
    """Check that flight software accepts these parameters; BadParams names all wrong values."""
    _refuse(name, check_limits(params))
    _refuse(name, check_arm(params))


def read_params_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file of parameters as a table; BadParams if the file cannot be read."""
    try:
        return read_toml(path)
    except RobotError as error:
        raise BadParams(str(error)) from error


def merge_tables(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return a table with the values of another one over it."""
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = merge_tables(base[key], value) if both else value
    return merged


def params_from_table(table: dict[str, Any], name: str) -> Params:
    """Make parameters of a table, as a TOML file has it; BadParams names all that is wrong."""
    _refuse(name, _find_dates(table))
    listed = _list_named(table)
    try:
        params = _ADAPTER.validate_json(json.dumps(listed), strict=True, extra="forbid")
    except ValidationError as error:
        faults = [f"{name}: {_place(table, e['loc'])}: {describe_fault(Params, e)}" for e in error.errors()]
        raise BadParams("\n".join(faults)) from error
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


def _place(table: dict[str, Any], location: KeyPath) -> str:
    """Return the place of an error, with the names of named records in place of their indices."""
    names = [*location]
    for place in NAMED:
        depth = place.count(".") + 1
        owner, key = _owner(table, place)
        if names[:depth] == place.split(".") and len(names) > depth and isinstance(owner.get(key), dict):
            names[depth] = list(owner[key])[int(names[depth])]
    return key_path(tuple(names))


def _refuse(name: str, problems: Iterator[str]) -> None:
    lines = [f"{name}: {problem}" for problem in problems]
    if lines:
        raise BadParams("\n".join(lines))


def _find_dates(value: Any, place: str = "") -> Iterator[str]:
    """List problems with dates and times, which TOML has and no parameter is."""
    if isinstance(value, date | time):
        yield f"{place}: {value} is a date or a time; no parameter is one"
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _find_dates(item, f"{place}.{key}" if place else str(key))


_ADAPTER = TypeAdapter(Params)
