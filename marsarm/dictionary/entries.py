"""Entries of the dictionary: commands, EVRs, channels and parameters; and their selection by a pattern."""

from collections.abc import Iterable, Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from enum import IntEnum
from fnmatch import fnmatchcase
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary import commands, evrs, faults
from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import Fault
from fsw.dictionary.params import Params
from fsw.dictionary.types import Limits, NameMark
from fsw.dictionary.validity import COMPONENT_LIMITS
from fsw.protect.responses import RESPONSE_TO
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.schema import (
    alias_docs,
    arm_names,
    array_shape,
    class_doc,
    field_docs,
    strip_optional,
    unit_of,
)
from marsarm.telemetry.topics import PACKET_TOPICS, channel_matches, channel_name
from sim.arms import nominal_params
from sim.scenario.records import suggest_name, upper_snake
from simgap.common.errors import BadRequest


@dataclass(frozen=True, slots=True)
class FieldDefinition:
    """Definition of a field: a number, flag, name, or an array of them."""

    name: str
    type: str
    unit: str | None
    """Unit; None for flags, names and text."""
    low: float | None
    high: float | None
    text: str
    default: Any = None
    """Default of an argument, or nominal value of a parameter; None if there is none."""


@dataclass(frozen=True, slots=True)
class Definition:
    """Definition of a command, an EVR or a packet of channels, with its fields."""

    name: str
    text: str
    fields: tuple[FieldDefinition, ...]


@dataclass(frozen=True, slots=True)
class CommandDefinition(Definition):
    """Definition of a command, which has another name in scenario files."""

    scenario_name: str


@dataclass(frozen=True, slots=True)
class EvrDefinition(Definition):
    """Definition of an EVR, with its severity."""

    severity: str
    message: str
    response: str | None
    """Response of flight software, if the EVR is a fault."""


@dataclass(frozen=True, slots=True)
class PacketDefinition(Definition):
    """Definition of a packet, which is a topic of a log; truth is state of the plant."""

    is_truth: bool


@dataclass(frozen=True, slots=True)
class Dictionary:
    """Dictionary of commands, EVRs, channels and parameters that flight and ground share."""

    commands: tuple[CommandDefinition, ...]
    evrs: tuple[EvrDefinition, ...]
    packets: tuple[PacketDefinition, ...]
    parameters: tuple[FieldDefinition, ...]


def build_dictionary() -> Dictionary:
    """Build the dictionary of this version."""
    return Dictionary(
        commands=tuple(_command(kind) for kind in get_args(Command)),
        evrs=tuple(_evr(kind) for kind in _evr_types()),
        packets=tuple(
            PacketDefinition(
                name=topic.name,
                text=class_doc(topic.packet),
                fields=tuple(one for one in _fields(topic.packet) if one.name in topic.field_names),
                is_truth=topic.is_truth,
            )
            for topic in PACKET_TOPICS.values()
        ),
        parameters=tuple(_parameters(Params, nominal_params(), "")),
    )


def _command(kind: type) -> CommandDefinition:
    return CommandDefinition(kind.__name__, class_doc(kind), tuple(_fields(kind)), upper_snake(kind))


def _evr_types() -> Iterator[type[Evr]]:
    """Yield every EVR in the order of the source."""
    for module in (evrs, faults):
        for kind in vars(module).values():
            is_event = isinstance(kind, type) and issubclass(kind, Evr) and kind not in (Evr, Fault)
            if is_event and kind.__module__ == module.__name__:
                yield kind


def _evr(kind: type[Evr]) -> EvrDefinition:
    response = RESPONSE_TO.get(kind) if issubclass(kind, Fault) else None
    return EvrDefinition(
        name=kind.__name__,
        text=class_doc(kind),
        fields=tuple(_fields(kind)),
        severity=kind.severity.name,
        message=kind.text,
        response=None if response is None else response.value,
    )


def _fields(kind: type) -> Iterator[FieldDefinition]:
    """Yield the fields of a command, an EVR or a packet."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        default = None if field.default is MISSING else record_to_json(field.default)
        yield _field(kind, field.name, hints[field.name], field.name, default)


def _parameters(kind: type, nominal: Any, place: str) -> Iterator[FieldDefinition]:
    """Yield the parameters of a group by dotted name; * stands for any element of a list."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        name, hint = f"{place}{field.name}", hints[field.name]
        value = None if nominal is None else getattr(nominal, field.name)
        if is_dataclass(hint) and isinstance(hint, type):
            yield from _parameters(hint, value, f"{name}.")
        elif get_origin(hint) is tuple and is_dataclass(get_args(hint)[0]):
            yield from _parameters(get_args(hint)[0], None, f"{name}.*.")
        else:
            yield _field(kind, field.name, hint, name, None if value is None else record_to_json(value))


def _field(kind: type, own: str, hint: Any, name: str, default: Any) -> FieldDefinition:
    unit = unit_of(own) if is_numeric_type(hint) else None
    limits = _limits(kind, own, hint)
    text = field_docs(kind).get(own) or _type_text(kind, own)
    low, high = (None, None) if limits is None else (limits.low, limits.high)
    return FieldDefinition(name, type_name(kind, own, hint), unit, low, high, text, default)


def _limits(kind: type, name: str, hint: Any) -> Limits | None:
    """Return the limits of a number, or of each component of a vector parameter."""
    own = (one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Limits))
    of_vector = (limits for unit, limits in COMPONENT_LIMITS.items() if name.endswith(unit))
    is_vector = get_origin(hint) is tuple and kind.__module__ != commands.__name__
    return next(own, None) or (next(of_vector, None) if is_vector else None)


def _type_text(kind: type, name: str) -> str:
    """Return the documentation of an enumeration, or of a named type such as Backlash."""
    if names := _names_of(get_type_hints(kind, include_extras=True)[name]):
        is_tool = names == nominal_params().tool_names
        return (
            "The tools on the turret."
            if is_tool
            else "The contact switches, one bit each in the sensor word."
        )
    hint = get_type_hints(kind)[name]
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return class_doc(hint)
    aliases = {value: alias for alias, value in vars(commands).items() if get_origin(value) is Literal}
    return alias_docs(commands.__name__).get(str(aliases.get(hint)), "")


def _names_of(hint: Any) -> tuple[str, ...]:
    """Return the nominal tools or switches if an annotation is of one of them, else nothing."""
    marks, arm = getattr(hint, "__metadata__", ()), arm_names(nominal_params())
    if NameMark.TOOL in marks:
        return arm.tools
    return arm.switches if NameMark.SWITCH in marks else ()


def is_numeric_type(hint: Any) -> bool:
    """Return whether an annotation is of numbers, which can have a unit."""
    if _names_of(hint):
        return False
    kind = strip_optional(hint)
    if get_origin(kind) is np.ndarray:
        return get_args(get_args(kind)[1])[0] is not np.bool_
    if get_origin(kind) is tuple:
        return is_numeric_type(get_args(kind)[0])
    return kind in (int, float)


def type_name(owner: type, name: str, hint: Any) -> str:
    """Return a type as text with its shape, such as float64[5]."""
    if names := _names_of(hint):
        return " | ".join(names)
    kind = strip_optional(hint)
    if get_origin(kind) is np.ndarray:
        shape = ", ".join(map(str, array_shape(owner, name, arm_names(nominal_params()))))
        return f"{np.dtype(get_args(get_args(kind)[1])[0]).name}[{shape}]"
    if get_origin(kind) is tuple:
        return _tuple_name(kind)
    if get_origin(kind) is Literal:
        return " | ".join(map(str, get_args(kind)))
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return " | ".join(member.name for member in kind)
    return {str: "text", bool: "flag", int: "int", float: "float"}[kind]


def _tuple_name(kind: Any) -> str:
    """Return float[3] for three numbers, float[6, 6] for six by six; ... stands for any number."""
    sizes = []
    while get_origin(kind) is tuple:
        arguments = get_args(kind)
        sizes.append("..." if arguments[-1] is Ellipsis else str(len(arguments)))
        kind = arguments[0]
    return f"{kind.__name__}[{', '.join(sizes)}]"


E = TypeVar("E", bound=Definition)


def filter_dictionary(dictionary: Dictionary, pattern: str) -> Dictionary:
    """Select the entries that match a pattern, and the matching fields of other entries; ignore case.

    A field matches by its own name, or with its entry as /sensors.current_A or /sensors/current_A. BadRequest
    says that nothing matches.
    """
    part = Dictionary(
        commands=tuple(_matching_entries(dictionary.commands, pattern)),
        evrs=tuple(_matching_entries(dictionary.evrs, pattern)),
        packets=tuple(_matching_entries(dictionary.packets, pattern)),
        parameters=tuple(one for one in dictionary.parameters if _matches(one.name, pattern)),
    )
    if not any((part.commands, part.evrs, part.packets, part.parameters)):
        raise BadRequest(f"dictionary: nothing is called {pattern!r}; {_suggest_name(dictionary, pattern)}")
    return part


def _matching_entries(entries: Iterable[E], pattern: str) -> Iterator[E]:
    for entry in entries:
        names = (entry.name, entry.scenario_name) if isinstance(entry, CommandDefinition) else (entry.name,)
        if any(_matches(name, pattern) for name in names):
            yield entry
            continue
        matching = tuple(
            one
            for one in entry.fields
            if _matches(one.name, pattern)
            or channel_matches(entry.name.lower(), one.name.lower(), pattern.lower())
        )
        if matching:
            yield replace(entry, fields=matching)


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name.lower(), pattern.lower())


def _suggest_name(dictionary: Dictionary, pattern: str) -> str:
    """Suggest a similar name; a list of all names would be a page."""
    entries: list[Definition] = [*dictionary.commands, *dictionary.evrs, *dictionary.packets]
    names = [entry.name for entry in entries] + [one.name for one in dictionary.parameters]
    names += [channel_name(packet.name, one.name) for packet in dictionary.packets for one in packet.fields]
    return (
        f"{suggest_name(pattern, names)}`marsarm dictionary` lists all there is, "
        "and a pattern is written as '*tilt*', where * stands for any letters"
    )
