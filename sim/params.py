"""Flight parameters from TOML files, checked strictly, with all errors in one message."""

import json
import tomllib
from collections.abc import Iterator
from dataclasses import asdict
from datetime import date, time
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits
from sim.old_names import find_new_name, renamed_text
from sim.text_file import UnreadableText, read_text

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
    return _validate(_merge(asdict(params), _read_toml(path)), str(path))


def check_params(params: Params, name: str) -> None:
    """Check that flight software accepts these parameters.

    Raises:
        BadParams: a value is wrong; the message names all that are.
    """
    _refuse(name, check_limits(params))
    _refuse(name, check_arm(params))


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_text(path))
    except UnreadableText as error:
        raise BadParams(f"{path}: {error}") from error
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
    try:
        params = _ADAPTER.validate_json(json.dumps(table), strict=True, extra="forbid")
    except ValidationError as error:
        lines = [
            f"{name}: {'.'.join(str(p) for p in e['loc'])}: {_error_text(e, params_names())}"
            for e in error.errors()
        ]
        raise BadParams("\n".join(lines)) from error
    check_params(params, name)
    return params


def _refuse(name: str, problems: Iterator[str]) -> None:
    lines = [f"{name}: {problem}" for problem in problems]
    if lines:
        raise BadParams("\n".join(lines))


@lru_cache(maxsize=1)
def params_names() -> tuple[str, ...]:
    """List the names of all parameters, such as `motion.takeup_rad`."""
    return tuple(_list_names(tomllib.loads(_nominal_text()), ""))


def _list_names(table: dict[str, Any], place: str) -> Iterator[str]:
    for key, value in table.items():
        yield f"{place}{key}"
        if isinstance(value, dict):
            yield from _list_names(value, f"{place}{key}.")


def _error_text(error: Any, names: tuple[str, ...]) -> str:
    """Return an error of pydantic in words of this project."""
    kind, context = error["type"], error.get("ctx", {})
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        new = find_new_name(".".join(str(part) for part in error["loc"]), names)
        return "is not a parameter" + ("" if new is None else f"; {renamed_text(new)}")
    if kind in ("too_short", "too_long"):
        wanted = context.get("min_length", context.get("max_length"))
        return f"has {context['actual_length']} values; {wanted} are right"
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
