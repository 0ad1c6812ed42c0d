"""Commands and EVRs as log messages: text for people, and fields as JSON."""

import json
import struct
from dataclasses import dataclass, fields
from typing import Any, Final, Self, get_type_hints

from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Evr, Severity
from marsarm.telemetry.json_codec import record_to_json
from marsarm.telemetry.schema import ENCAPSULATION, CdrWriter, align, ros_time

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
    """Base of the messages without a fixed layout; their fields are integers and strings."""

    @classmethod
    def ros_text(cls) -> str:
        """Return the body of the ROS 2 message definition."""
        names = {int: "int64", str: "string"}
        return "".join(f"{names[kind]} {name}\n" for name, kind in get_type_hints(cls).items())

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
        """Decode a message that `encode` made.

        Raises:
            struct.error, UnicodeDecodeError, ValueError: the message is damaged.
        """
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


def rosout_message(time_ns: int, evr: Evr) -> bytes:
    """Encode an EVR as rcl_interfaces/Log, for the log panels of other tools."""
    out = CdrWriter().add("iI", *ros_time(time_ns)).add("B", LOG_LEVELS[evr.severity])
    return bytes(out.text(evr.name).text(evr.message).text("").text("").add("I", 0).data)
