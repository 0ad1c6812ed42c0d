"""Flight parameters from TOML files, checked strictly, with all errors in one message."""

import json
import os
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import asdict
from datetime import date, time
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits

MAX_BYTES: Final = 1_000_000
"""Largest size of a file, seventy times that of all parameters."""

NAMED: Final = ("tools", "switches", "collision.rover")
"""Tables of a parameter file whose keys are names of records."""


class BadParams(ValueError):
    """Parameter file that is refused; the message names every wrong field."""


def nominal_params() -> Params:
    """Return the parameters of the drawing."""
    return _load_nominal(_nominal_text())


def params_over_nominal(path: Path) -> Params:
    """Read a TOML file with any part of the parameters; the others are nominal.

    Raises:
        BadParams: the file cannot be read, or names or values in it are wrong.
    """
    return _validate(_merge(tomllib.loads(_nominal_text()), _read_toml(path)), str(path))


def params_over(params: Params, path: Path) -> Params:
    """Read a TOML file with any part of the parameters; the others come from `params`.

    Raises:
        BadParams: the file cannot be read, or names or values in it are wrong.
    """
    return _validate(_merge(params_table(params), _read_toml(path)), str(path))


def params_table(params: Params) -> dict[str, Any]:
    """Return parameters as tables, as they stand in a TOML file: records with a name by their names."""
    table = asdict(params)
    for place in NAMED:
        owner, key = _owner(table, place)
        owner[key] = {str(record.pop("name")).lower(): record for record in owner[key]}
    table["switches"] = {name: record["tool"].lower() for name, record in table["switches"].items()}
    return table


def check_params(params: Params, name: str) -> None:
    """Check that flight software accepts these parameters.

    Raises:
        BadParams: a value is wrong; the message names all that are.
    """
    _refuse(name, check_limits(params))
    _refuse(name, check_arm(params))


def _read_toml(path: Path) -> dict[str, Any]:
    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe blocks, a device has no end
        raise BadParams(f"{path}: cannot be read: it is not a regular file; give the path of a TOML file")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise BadParams(f"{path}: is too large for parameters; the limit is {MAX_BYTES} bytes")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise BadParams(f"{path}: cannot be read: {error}") from error
    except (ValueError, RecursionError) as error:  # cut off, or an endless number or list
        raise BadParams(f"{path}: is not TOML: {error}") from error


def _nominal_text() -> str:
    return resources.files("fsw.dictionary").joinpath("nominal.toml").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _load_nominal(text: str) -> Params:
    """Check the nominal parameters once; effects and simulations request them thousands of times."""
    return _validate(tomllib.loads(text), "nominal.toml")


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merge(base[key], value) if both else value
    return merged


def _validate(table: dict[str, Any], name: str) -> Params:
    _refuse(name, _find_dates(table))
    listed = _list_named(table)
    try:
        params = _ADAPTER.validate_json(json.dumps(listed), strict=True, extra="forbid")
    except ValidationError as error:
        lines = [f"{name}: {_place(table, e['loc'])}: {_error_text(e)}" for e in error.errors()]
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
        return {"name": name.upper(), "tool": value.upper() if isinstance(value, str) else value}
    if not isinstance(value, dict):
        return value
    if place == "tools":
        return {"title": name.replace("_", " "), **value, "name": name.upper()}
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


def _error_text(error: Any) -> str:
    """Return the error of pydantic without its words about function calls."""
    unknown = error["type"] in ("unexpected_keyword_argument", "extra_forbidden")
    return "is not a parameter" if unknown else str(error["msg"])


def _find_dates(value: Any, place: str = "") -> Iterator[str]:
    """List problems with dates and times, which TOML has and no parameter is."""
    if isinstance(value, date | time):
        yield f"{place}: {value} is a date or a time; no parameter is one"
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _find_dates(item, f"{place}.{key}" if place else str(key))


_ADAPTER = TypeAdapter(Params)
