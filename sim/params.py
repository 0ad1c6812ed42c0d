"""Flight parameters from TOML, strictly: every error at once, each with its place, and one digest."""

import hashlib
import json
import math
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from importlib import resources
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.params import Limits, Params


class BadParams(ValueError):
    """A parameter file that is not to be flown; the message names every field at fault."""


def nominal_params() -> Params:
    """The parameters of the drawing."""
    return _validated(_nominal_table(), "nominal.toml")


def params_over_nominal(path: Path) -> Params:
    """The nominal parameters with those of a TOML file in their place; the file may give any part of them.

    Raises:
        BadParams: the file cannot be read, or names or values in it are wrong.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise BadParams(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise BadParams(f"{path}: is not TOML: {error}") from error
    return _validated(_merged(_nominal_table(), table), str(path))


def _nominal_table() -> dict[str, Any]:
    return tomllib.loads(
        resources.files("fsw.dictionary").joinpath("nominal.toml").read_text(encoding="utf-8")
    )


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merged(base[key], value) if both else value
    return merged


def _validated(table: dict[str, Any], name: str) -> Params:
    try:
        params = _ADAPTER.validate_json(json.dumps(table), strict=True, extra="forbid")
    except ValidationError as error:
        lines = [f"{name}: {'.'.join(str(p) for p in e['loc'])}: {e['msg']}" for e in error.errors()]
        raise BadParams("\n".join(lines)) from error
    problems = [f"{name}: {problem}" for problem in out_of_limits(params)]
    if problems:
        raise BadParams("\n".join(problems))
    return params


def digest(params: Params) -> str:
    """SHA-256 of the parameters' values, the same for the same values however they were written."""
    return hashlib.sha256(json.dumps(asdict(params), sort_keys=True).encode()).hexdigest()


def out_of_limits(record: Any, place: str = "") -> Iterator[str]:
    """Sentences about numbers outside their limits or not finite, and ranges that are upside down."""
    hints = get_type_hints(type(record), include_extras=True)
    for field in fields(record):
        value, where = getattr(record, field.name), f"{place}{field.name}"
        if is_dataclass(value):
            yield from out_of_limits(value, f"{where}.")
            continue
        if not all(math.isfinite(v) for v in _numbers(value)):
            yield f"{where}: must be finite, is {value}"
        for limits in getattr(hints[field.name], "__metadata__", ()):
            if isinstance(limits, Limits) and not limits.low <= value <= limits.high:
                yield f"{where}: {value} is outside {limits.low} .. {limits.high}"
    low, high = getattr(record, "soft_min_rad", 0.0), getattr(record, "soft_max_rad", 1.0)
    if not low < high:
        yield f"{place}soft_min_rad: {low} is not below soft_max_rad {high}"


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, float):
        yield value


_ADAPTER = TypeAdapter(Params)
