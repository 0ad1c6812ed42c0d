"""Commands, EVRs and other records as JSON, and as log messages with text for people."""

import json
import struct
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import IntEnum
from types import NoneType
from typing import Any, Literal, Self, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary.arguments import MAX_FLOAT
from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Evr
from fsw.dictionary.validity import read_hints
from marsarm.telemetry.format import SchemaError
from marsarm.telemetry.schema import ENCAPSULATION, CdrWriter, align, ros_definition, strip_optional

COMMAND_TYPES: dict[str, type[Command]] = {kind.__name__: kind for kind in get_args(Command)}


class BadJson(ValueError):
    """Error of JSON that does not fit its record; the message says where, and what would be right."""


def record_to_json(value: Any) -> Any:
    """Encode a record, or a value in it, as JSON: fields by name, enums by name, tuples and arrays as lists.

    Floats read back bit for bit. NaN and infinities are written as Python's `json` writes them. SchemaError
    says that a value has no JSON type.
    """
    match value:
        case IntEnum():
            return value.name
        case None | bool() | int() | float() | str():
            return value
        case tuple() | list():
            return [record_to_json(item) for item in value]
        case _ if is_dataclass(value):
            return {f.name: record_to_json(getattr(value, f.name)) for f in fields(value)}
        case _ if hasattr(value, "tolist"):  # numpy arrays and scalars
            return value.tolist()
        case _:
            raise SchemaError(f"{type(value).__name__} in a command or EVR; use numbers, text, enums, tuples")


def record_from_json(kind: Any, value: Any, place: str, notes: list[str], base: Any = None) -> Any:
    """Decode a value of a type, a record or a field, that `record_to_json` encoded; BadJson if it is not.

    Another version may have written other fields. Unknown fields are left out; missing fields are taken from
    `base` or from their defaults. A sentence for each is added to `notes`.
    """
    if value is None and NoneType in get_args(kind):
        return None
    kind = strip_optional(kind)
    origin = get_origin(kind)
    if is_dataclass(kind) and isinstance(kind, type):
        return _decode_record(kind, value, place, notes, base)
    if origin is tuple:
        return _decode_tuple(get_args(kind), value, place, notes)
    if origin is np.ndarray:
        return _decode_array(np.dtype(get_args(get_args(kind)[1])[0]), value, place)
    if origin is Literal:
        return _check_choice(get_args(kind), value, place)
    if issubclass(kind, IntEnum):
        return kind[_check_choice(tuple(kind.__members__), value, place)]
    if kind is float and not _fits_float(value):
        raise BadJson(f"{place}: {value!r:.80} is larger than any float")
    # A person may write an integer where a float is due; it stays an integer.
    if not isinstance(value, (int, float) if kind is float else kind) or (
        isinstance(value, bool) and kind is not bool
    ):
        raise BadJson(f"{place}: {value!r:.80} is no {kind.__name__}")
    return value


def command_from_json(name: str, arguments: Any, notes: list[str]) -> Command:
    """Decode a command from its name and its arguments; BadJson if one of them is wrong."""
    kind = COMMAND_TYPES[_check_choice(tuple(COMMAND_TYPES), name, "command")]
    command: Command = record_from_json(kind, arguments, name, notes)
    return command


def _decode_record(kind: type, value: Any, place: str, notes: list[str], base: Any) -> Any:
    if not isinstance(value, dict):
        raise BadJson(f"{place}: {value!r:.80} is not the fields of a {kind.__name__}")
    hints = read_hints(kind)
    known = {f.name: f for f in fields(kind)}
    notes += [f"{place}.{name} is not known today: left out" for name in value if name not in known]
    values = {}
    for name, field in known.items():
        inner = None if base is None else getattr(base, name)
        if name in value:
            values[name] = record_from_json(hints[name], value[name], f"{place}.{name}", notes, inner)
        elif inner is None and field.default is MISSING:
            raise BadJson(f"{place}.{name} is missing")
        else:
            values[name] = field.default if inner is None else inner
            notes.append(f"{place}.{name} was not known then: today's {values[name]!r:.80} is taken")
    return kind(**values)


def _decode_tuple(kinds: tuple[Any, ...], value: Any, place: str, notes: list[str]) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise BadJson(f"{place}: {value!r:.80} is no list")
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value):
        raise BadJson(f"{place}: has {len(value)} items, {len(kinds)} would be right")
    return tuple(
        record_from_json(kind, v, f"{place}.{k}", notes)
        for k, (kind, v) in enumerate(zip(kinds, value, strict=True))
    )


def _decode_array(dtype: np.dtype[Any], value: Any, place: str) -> Any:
    """Decode an array of one dimension, of flags or floats."""
    kinds = (bool,) if dtype.kind == "b" else (int, float)
    if not isinstance(value, list) or not all(type(item) in kinds and _fits_float(item) for item in value):
        raise BadJson(f"{place}: {value!r:.80} is no list of {dtype}")
    return np.array(value, dtype)


def _fits_float(value: Any) -> bool:
    """Return whether a value is not an integer beyond all floats."""
    return not isinstance(value, int) or abs(value) <= MAX_FLOAT


def _check_choice(words: tuple[str, ...], value: Any, place: str) -> str:
    if value not in words:
        raise BadJson(f"{place}: {value!r:.80} is not known; there are {', '.join(words)}")
    return str(value)


@dataclass(frozen=True, slots=True)
class LogEntry:
    """Base of the messages without a fixed layout; their fields are integers and strings."""

    @classmethod
    def ros_definition(cls) -> bytes:
        """Return the ROS 2 message definition."""
        names = {int: "int64", str: "string"}
        lines = "".join(f"{names[kind]} {name}\n" for name, kind in get_type_hints(cls).items())
        return ros_definition(cls.__doc__, lines)

    def encode(self) -> bytes:
        """Encode the entry in CDR: integers of eight bytes; strings with a length, ended by a zero."""
        out = CdrWriter()
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int):
                out.add("q", value)
            else:
                out.text(value)
        return bytes(out.data)

    @classmethod
    def decode(cls, message: bytes) -> Self:
        """Decode what `encode` made; struct.error, UnicodeDecodeError or ValueError if it is damaged."""
        values: list[int | str] = []
        at = len(ENCAPSULATION)
        for kind in get_type_hints(cls).values():
            if kind is int:
                at = align(at, 8)
                values += struct.unpack_from("<q", message, at)
                at += 8
            else:
                at = align(at, 4)
                (length,) = struct.unpack_from("<I", message, at)
                values.append(message[at + 4 : at + 4 + length - 1].decode())
                at += 4 + length
        if at != len(message):
            raise ValueError(f"{cls.__name__} of {len(message)} bytes, {at} would be right")
        return cls(*values)


@dataclass(frozen=True, slots=True)
class EvrEntry(LogEntry):
    """An event report of flight software."""

    tick: int
    severity: int
    name: str
    message: str
    fields_json: str

    @property
    def fields(self) -> dict[str, Any]:
        """Fields by name; enums by name, tuples and arrays as lists."""
        return dict(json.loads(self.fields_json))


@dataclass(frozen=True, slots=True)
class CommandEntry(LogEntry):
    """A command that flight software was given."""

    tick: int
    name: str
    fields_json: str

    @property
    def fields(self) -> dict[str, Any]:
        """Arguments by name; enums by name, tuples as lists."""
        return dict(json.loads(self.fields_json))


def json_fields(event: Evr | Command) -> dict[str, Any]:
    """Encode the fields of a command or EVR as JSON."""
    return {f.name: record_to_json(getattr(event, f.name)) for f in fields(event)}


def evr_entry(tick: int, evr: Evr) -> EvrEntry:
    """Return the log entry of an EVR."""
    return EvrEntry(tick, evr.severity, evr.name, evr.message, json.dumps(json_fields(evr)))


def command_entry(tick: int, command: Command) -> CommandEntry:
    """Return the log entry of a command."""
    return CommandEntry(tick, type(command).__name__, json.dumps(json_fields(command)))
