"""Records as JSON has them, and back again, exactly: commands, parameters, what flight software remembers."""

from dataclasses import MISSING, Field, fields, is_dataclass
from enum import IntEnum
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary.commands import Command
from ground.telemetry.events import as_json
from ground.telemetry.topics import required

COMMANDS: dict[str, type[Command]] = {kind.__name__: kind for kind in get_args(Command)}


class NotPlain(ValueError):
    """JSON that does not fit the record it is to be; the message says where and what would."""


def to_plain(value: Any) -> Any:
    """A record in JSON's words: fields by name, enums by name, tuples and arrays as lists.

    Floats are written so that they read back bit for bit; NaN and infinities as Python's JSON has them.

    Raises:
        SchemaError: JSON has no word for something in it.
    """
    if is_dataclass(value):
        return {f.name: to_plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple):
        return [to_plain(item) for item in value]
    return as_json(value)


def from_plain(kind: Any, value: Any, place: str, notes: list[str], base: Any = None) -> Any:
    """The record of a type that `to_plain` put into JSON's words.

    A record made by another version may lack a field, which is then that of `base` or its default, or have
    one that is gone, which is left out; `notes` gets a sentence for each.

    Raises:
        NotPlain: a value is not of its type, or a field is missing.
    """
    kind = required(kind)
    origin = get_origin(kind)
    if is_dataclass(kind) and isinstance(kind, type):
        return _record(kind, value, place, notes, base)
    if origin is tuple:
        return _tuple(get_args(kind), value, place, notes)
    if origin is np.ndarray:
        return _array(np.dtype(get_args(get_args(kind)[1])[0]), value, place)
    if origin is Literal:
        return _one_of(get_args(kind), value, place)
    if issubclass(kind, IntEnum):
        return kind[_one_of(tuple(kind.__members__), value, place)]
    # A whole number stands for a float where a person wrote one; it stays what it was.
    if not isinstance(value, (int, float) if kind is float else kind) or (
        isinstance(value, bool) and kind is not bool
    ):
        raise NotPlain(f"{place}: {value!r:.80} is no {kind.__name__}")
    return value


def command_from(name: str, arguments: Any, notes: list[str]) -> Command:
    """The command of this name with these arguments.

    Raises:
        NotPlain: there is no such command, or an argument is wrong.
    """
    kind = COMMANDS[_one_of(tuple(COMMANDS), name, "command")]
    command: Command = from_plain(kind, arguments, name, notes)
    return command


def _record(kind: type, value: Any, place: str, notes: list[str], base: Any) -> Any:
    if not isinstance(value, dict):
        raise NotPlain(f"{place}: {value!r:.80} is not the fields of a {kind.__name__}")
    hints = get_type_hints(kind, include_extras=True)
    known = {f.name: f for f in fields(kind)}
    notes += [f"{place}.{name} is not known today: left out" for name in value if name not in known]
    made = {}
    for name, field in known.items():
        inner = None if base is None else getattr(base, name)
        if name in value:
            made[name] = from_plain(hints[name], value[name], f"{place}.{name}", notes, inner)
        else:
            made[name] = _missing(field, inner, place)
            notes.append(f"{place}.{name} was not known then: today's {made[name]!r:.80} is taken")
    return kind(**made)


def _missing(field: Field[Any], base: Any, place: str) -> Any:
    if base is None and field.default is MISSING:
        raise NotPlain(f"{place}.{field.name} is missing")
    return field.default if base is None else base


def _tuple(kinds: tuple[Any, ...], value: Any, place: str, notes: list[str]) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise NotPlain(f"{place}: {value!r:.80} is no list")
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value):
        raise NotPlain(f"{place}: has {len(value)} items, {len(kinds)} would be right")
    return tuple(
        from_plain(kind, v, f"{place}.{k}", notes)
        for k, (kind, v) in enumerate(zip(kinds, value, strict=True))
    )


def _array(dtype: np.dtype[Any], value: Any, place: str) -> Any:
    """One row of flags or floats."""
    kinds = (bool,) if dtype.kind == "b" else (int, float)
    if not isinstance(value, list) or not all(type(item) in kinds for item in value):
        raise NotPlain(f"{place}: {value!r:.80} is no list of {dtype}")
    return np.array(value, dtype)


def _one_of(words: tuple[str, ...], value: Any, place: str) -> str:
    if value not in words:
        raise NotPlain(f"{place}: {value!r:.80} is not known; there are {', '.join(words)}")
    return str(value)
