"""Effects as tables of a TOML file: the class of an effect, its fields and its sizes."""

import importlib
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any, Final, cast, get_args, get_origin, get_type_hints

import numpy as np

from simgap.arrays import Array
from simgap.catalogue.own_effects import load_module
from simgap.common.errors import RobotError
from simgap.effects.effect import Effect

PACKAGE: Final = "simgap"
"""Package whose effects are named by their module; those of other modules by their file."""


def effect_table(effect: Effect, size: Sequence[float]) -> dict[str, Any]:
    """Return a table from which `read_effect` makes the effect again."""
    kind = type(effect)
    is_own = kind.__module__.partition(".")[0] != PACKAGE
    file = {"file": str(Path(sys.modules[kind.__module__].__file__ or "").resolve())} if is_own else {}
    return {
        "effect": effect.name,
        "place": effect.place,
        "text": effect.describe(np.asarray(size, dtype=float)),
        **file,
        "class": kind.__qualname__ if is_own else f"{kind.__module__}:{kind.__qualname__}",
        "size": {one.name: float(value) for one, value in zip(effect.sizes, size, strict=True)},
        "fields": _plain(effect),
    }


def read_effect(table: Mapping[str, Any], path: Path) -> tuple[Effect, Array]:
    """Make the effect of a table.

    Args:
        table: Table as `effect_table` makes it. The file of an effect of one's own is run.
        path: File of the table, for errors.

    Returns:
        The effect, and its sizes, (n_sizes,) in the units of their names.

    Raises:
        RobotError: The table names no effect, or its sizes are not those of the effect.
    """
    try:
        kind = _effect_class(table)
        effect = cast(Effect, _build(kind, table["fields"]))
        size = table["size"]
    except (KeyError, TypeError, ValueError, ImportError, AttributeError, OSError) as error:
        name = table.get("effect", "an effect")
        raise RobotError(f"{path}: {name}: cannot be made ({error}); write the file again") from error
    names = [one.name for one in effect.sizes]
    if list(size) != names:
        raise RobotError(f"{path}: {effect.key}: size has {', '.join(size)}; it takes {', '.join(names)}")
    return effect, np.array([float(size[name]) for name in names])


def toml_text(tables: Mapping[str, Any]) -> str:
    """Write values and lists of tables as TOML; a table within another is written in one line."""
    return "\n".join(_lines(tables)) + "\n"


def _effect_class(table: Mapping[str, Any]) -> type[Effect]:
    if "file" in table:
        module: Any = _module_of_file(Path(table["file"]))
        name = table["class"]
    else:
        place, _, name = table["class"].partition(":")
        if place.partition(".")[0] != PACKAGE:
            raise ValueError(f"{place} is no module of {PACKAGE}")
        module = importlib.import_module(place)
    kind = getattr(module, name)
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise TypeError(f"{name} is no effect")
    return kind


def _module_of_file(file: Path) -> ModuleType:
    loaded = (one for one in list(sys.modules.values()) if getattr(one, "__file__", None) == str(file))
    return next(loaded, None) or load_module(file)


def _plain(value: Any) -> Any:
    """Return a record as a table; None has no place in TOML and is left out."""
    if is_dataclass(value) and not isinstance(value, type):
        values = {one.name: getattr(value, one.name) for one in fields(value)}
        return {name: _plain(each) for name, each in values.items() if each is not None}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return value


def _build(kind: Any, value: Any) -> Any:
    """Make a value of a type from a table, by the types of the fields."""
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        known = {one.name: hints[one.name] for one in fields(kind)}
        made = {name: _build(known[name], each) for name, each in value.items()}
        absent = {name: None for name in known if name not in made}
        return cast(Any, kind)(**made, **absent)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        each = [inner[0]] * len(value) if inner[1:] == (...,) else inner
        return tuple(_build(one, part) for one, part in zip(each, value, strict=True))
    return float(value) if kind is float else value


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield values first, because they would belong to a table above them."""
    for key, value in table.items():
        if not _is_list_of_tables(value):
            yield f"{_key(key)} = {_value(value)}"
    for key, value in table.items():
        for one in value if _is_list_of_tables(value) else ():
            yield from ("", f"[[{_key(key)}]]", *_lines(one))


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(key)} = {_value(one)}' for key, one in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value)  # a JSON string is a basic string of TOML
    return repr(value).lower() if isinstance(value, bool) else repr(value)
