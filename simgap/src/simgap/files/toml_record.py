"""Records that are read from TOML files, and their errors as one sentence."""

import tomllib
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from simgap.common.errors import RobotError

MAX_BYTES = 1 << 20
"""Largest size of a file of settings; a larger one is not one."""


class Record(BaseModel):
    """Table of a TOML file: no unknown keys, no conversion of types, only finite numbers."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


R = TypeVar("R", bound=Record)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        RobotError: it is absent, too large, or no TOML.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise RobotError(f"{path}: is no regular file; name a TOML file")
        if path.stat().st_size > MAX_BYTES:
            raise RobotError(f"{path}: is larger than 1 MB; name a TOML file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror}); name a file that exists") from error
    except UnicodeDecodeError as error:
        raise RobotError(f"{path}: is not UTF-8 text; name a TOML file") from error
    except ValueError as error:  # a zero byte in the name
        raise RobotError(f"{str(path)!r}: is no name of a file; name a TOML file") from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RobotError(f"{path}: is not TOML: {error}") from error
    except (ValueError, RecursionError) as error:
        raise RobotError(f"{path}: has a number with too many digits or a list in too many lists") from error


def parse_record(kind: type[R], content: dict[str, Any], path: Path) -> R:
    """Check the content of a file.

    Raises:
        RobotError: a key is unknown or missing, or a value is wrong; the text gives the path of the key.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        # The first unknown key explains a missing one better than the reverse: it is often its misspelling.
        faults = sorted(error.errors(), key=lambda one: one["type"] == "missing")
        raise RobotError(_sentence(kind, faults[0], path)) from error


def _sentence(kind: type[Record], fault: Any, path: Path) -> str:
    loc: tuple[str | int, ...] = fault["loc"]
    key = ".".join(map(str, loc))
    match fault["type"]:
        case "missing":
            return f"{path}: {key}: is missing; add it"
        case "extra_forbidden" | "unexpected_keyword_argument":
            near = get_close_matches(str(loc[-1]), _fields(kind, loc[:-1]), 1)
            return f"{path}: {key}: is not known" + (f"; did you mean {near[0]}?" if near else "; remove it")
        case "value_error":
            text = str(fault["ctx"]["error"])
            return f"{path}: {key}: {text}" if key else f"{path}: {text}"
        case _:
            said = fault["msg"][0].lower() + fault["msg"][1:]
            shown = "" if isinstance(fault["input"], dict | list) else f", not {fault['input']!r}"
            said = said.removeprefix("input ").removesuffix(", not 0").removesuffix(" after validation")
            return f"{path}: {key}: {said}{shown}"


def _fields(kind: type[Record], loc: tuple[str | int, ...]) -> list[str]:
    """Return the keys that the table at this place may have."""
    found: Any = kind
    for name in loc:
        if isinstance(found, type) and issubclass(found, BaseModel):
            found = found.model_fields[str(name)].annotation if name in found.model_fields else None
        elif getattr(found, "__origin__", None) in (dict, list):
            found = found.__args__[-1]
        elif is_dataclass(found):
            found = next((one.type for one in fields(found) if one.name == name), None)
        if getattr(found, "__args__", None) and type(None) in found.__args__:
            found = next(one for one in found.__args__ if one is not type(None))
    if is_dataclass(found):
        return [one.name for one in fields(found)]
    return list(found.model_fields) if isinstance(found, type) and issubclass(found, BaseModel) else []
