"""Commands and EVRs as messages: the words that people read, and the fields as JSON."""

import json
import struct
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, Final, Self, get_type_hints

from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Evr, Severity
from ground.telemetry.errors import SchemaError
from ground.telemetry.schema import ENCAPSULATION, CdrWriter, align, ros_time

LOG_LEVELS: Final = {
    Severity.DIAGNOSTIC: 10,
    Severity.ACTIVITY_LO: 20,
    Severity.ACTIVITY_HI: 20,
    Severity.COMMAND: 20,
    Severity.WARNING_LO: 30,
    Severity.WARNING_HI: 40,
    Severity.FATAL: 50,
}
"""Levels of rcl_interfaces/Log: debug, info, warning, error, fatal."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """A line of the log: whole numbers and strings; the kinds below say which."""

    @classmethod
    def ros_text(cls) -> str:
        """The body of the ROS 2 message definition."""
        names = {int: "int64", str: "string"}
        return "".join(f"{names[kind]} {name}\n" for name, kind in get_type_hints(cls).items())

    def encode(self) -> bytes:
        """The entry in CDR: numbers on eight bytes; strings with their length, ended by a zero."""
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
        """The entry that `encode` gave; struct.error, UnicodeDecodeError or ValueError where it did not."""
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
        """The typed fields; enums by name, tuples and arrays as lists."""
        return dict(json.loads(self.fields_json))


@dataclass(frozen=True, slots=True)
class CommandEntry(LogEntry):
    """A command that flight software was given."""

    tick: int
    name: str
    fields_json: str

    @property
    def fields(self) -> dict[str, Any]:
        """The arguments; enums by name, tuples as lists."""
        return dict(json.loads(self.fields_json))


def json_value(value: Any) -> Any:
    """A command's or EVR's field in JSON's words; NaN and infinities stay, as Python's JSON has them.

    Raises:
        SchemaError: JSON has no word for it.
    """
    match value:
        case IntEnum():
            return value.name
        case None | bool() | int() | float() | str():
            return value
        case tuple() | list():
            return [json_value(item) for item in value]
        case _ if hasattr(value, "tolist"):  # numpy arrays and scalars
            return value.tolist()
        case _:
            raise SchemaError(f"{type(value).__name__} in a command or EVR; use numbers, text, enums, tuples")


def json_fields(event: Evr | Command) -> dict[str, Any]:
    """The fields of a command or EVR in JSON's words."""
    return {f.name: json_value(getattr(event, f.name)) for f in fields(event)}


def evr_entry(tick: int, evr: Evr) -> EvrEntry:
    """An EVR as it goes into the log."""
    return EvrEntry(tick, evr.severity, evr.name, evr.message, json.dumps(json_fields(evr)))


def command_entry(tick: int, command: Command) -> CommandEntry:
    """A command as it goes into the log."""
    return CommandEntry(tick, type(command).__name__, json.dumps(json_fields(command)))


def rosout_message(time_ns: int, evr: Evr) -> bytes:
    """An EVR as a rcl_interfaces/Log, for the log panels of others."""
    out = CdrWriter().add("iI", *ros_time(time_ns)).add("B", LOG_LEVELS[evr.severity])
    return bytes(out.text(evr.name).text(evr.message).text("").text("").add("I", 0).data)
