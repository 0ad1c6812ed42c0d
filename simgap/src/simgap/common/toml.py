"""TOML files: the one reader, the one writer, and errors that name the key; strict JSON files."""

import sys
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import read_bytes


class Record(BaseModel):
    """Table of a TOML file: no unknown keys, no conversion of types, only finite numbers."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


MAX_BYTES: Final = 1_000_000
"""Largest size of a file of settings, seventy times that of all flight parameters."""
NOT_UTF8: Final = "is not text in UTF-8; save it as UTF-8"

KeyPath = tuple[str | int, ...]
"""Keys and indices, from 0, that lead to a value."""


T = TypeVar("T")
R = TypeVar("R", bound=BaseModel)


def read_text(path: Path) -> str:
    """Read a text file in UTF-8; RobotError if it cannot be read, is no regular file, or is too large."""
    return decode_text(read_bytes(path, MAX_BYTES, "a text file"), str(path))


def decode_text(data: bytes, name: str) -> str:
    """Decode a text in UTF-8, with or without a byte order mark; RobotError, with the name, if it is none."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RobotError(f"{name}: {NOT_UTF8}") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; RobotError if it cannot be read, or is no TOML."""
    return parse_toml(read_text(path), str(path))


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse a text as TOML; RobotError if it is no TOML, or holds what Python cannot print."""
    try:
        table = tomllib.loads(text)
        repr(table)  # a hexadecimal number is read with any number of digits
    except tomllib.TOMLDecodeError as error:
        raise RobotError(f"{name}: is not TOML: {error}") from error
    except RecursionError as error:
        raise RobotError(f"{name}: is not TOML: lists or tables are nested too deeply") from error
    except ValueError as error:
        digits = sys.get_int_max_str_digits()
        raise RobotError(f"{name}: is not TOML: a whole number has more than {digits} digits") from error
    return table


def toml_text(table: Mapping[str, Any], comments: Iterable[str] = ()) -> str:
    """Write a table as TOML, from which every bit can be read again, below comment lines."""
    import tomlkit  # most commands read only

    document = tomlkit.item(dict(table))
    _spread_matrices(document)
    head = "".join(f"{f'# {line}'.rstrip()}\n" for line in comments)
    return f"{head}\n{tomlkit.dumps(document)}" if head else tomlkit.dumps(document)


def _spread_matrices(value: Any) -> None:
    """Give each row of a matrix a line of its own."""
    if hasattr(value, "multiline"):
        value.multiline(any(isinstance(row, list) for row in value))
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            _spread_matrices(one)


def parse_record(kind: type[R], content: dict[str, Any], path: Path) -> R:
    """Check the content of a file; RobotError, with the path of the key, if a key or a value is wrong."""
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise RobotError(f"{path}: {describe_faults(kind, error)[0]}") from error


def describe_faults(kind: type, error: ValidationError) -> list[str]:
    """Return a sentence for each fault of a document, with the path of its key.

    The first unknown key explains a missing one better than the reverse: it is often its misspelling.
    """
    faults: list[Any] = sorted(error.errors(), key=lambda one: one["type"] == "missing")
    said = ((key_path(one["loc"]), describe_fault(kind, one)) for one in faults)
    return [f"{where}: {what}" if where else what for where, what in said]


def key_path(place: KeyPath) -> str:
    """Return the path of a key as text, such as command[3].tool; tables of a list count from 1."""
    return "".join(f"[{key + 1}]" if isinstance(key, int) else f".{key}" for key in place).removeprefix(".")


def describe_fault(kind: type, fault: Any) -> str:
    """Return what is wrong with a value."""
    loc: KeyPath = fault["loc"]
    match fault["type"]:
        case "missing":
            return "is missing; add it"
        case "extra_forbidden" | "unexpected_keyword_argument":
            near = get_close_matches(str(loc[-1]), _fields(kind, loc[:-1]), 1)
            return "is not known" + (f"; did you mean {near[0]}?" if near else "; remove it")
        case "value_error":
            return str(fault["ctx"]["error"])
        case _:
            said = fault["msg"][0].lower() + fault["msg"][1:]
            shown = "" if isinstance(fault["input"], dict | list) else f", not {fault['input']!r}"
            said = said.removeprefix("input ").removesuffix(", not 0").removesuffix(" after validation")
            said = said.replace("tuple", "list").replace("an object", "a table")
            return f"{said}{shown}"


def _fields(kind: Any, place: KeyPath) -> list[str]:
    """Return the keys that the table at a place may have."""
    found = kind
    for name in place:
        if isinstance(found, type) and issubclass(found, BaseModel):
            found = found.model_fields[str(name)].annotation if name in found.model_fields else None
        elif get_origin(found) in (dict, list, tuple):
            found = next(one for one in reversed(get_args(found)) if one is not Ellipsis)
        elif is_dataclass(found):
            found = next((one.type for one in fields(found) if one.name == name), None)
        if type(None) in get_args(found):
            found = next(one for one in get_args(found) if one is not type(None))
    if is_dataclass(found):
        return [one.name for one in fields(found)]
    return list(found.model_fields) if isinstance(found, type) and issubclass(found, BaseModel) else []


def read_json(path: Path, adapter: TypeAdapter[T], otherwise: str, advice: str) -> T:
    """Read a JSON file strictly as a type; BadRequest if it is another, with `otherwise` and `advice`."""
    try:
        return adapter.validate_json(path.read_bytes(), strict=True)
    except OSError as error:
        raise BadRequest(f"{path}: cannot be read ({error.strerror}); {advice}") from error
    except ValidationError as error:
        raise BadRequest(f"{path}: {otherwise} ({describe_first_problem(error)}); {advice}") from error


def describe_first_problem(error: ValidationError) -> str:
    """Return the first problem of a document in one line: where it is, and what it is."""
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"]))
    return f"{where}: {first['msg']}" if where else str(first["msg"])
