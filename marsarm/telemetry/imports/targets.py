"""Targets of a mapping: flight channels by name, and custom channels that only the table has."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Final, get_type_hints

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.types import match_name
from marsarm.common.fields import UNIT_SYMBOLS, unit_of
from marsarm.telemetry.imports.units import UNIT_CONVERSIONS, Conversion
from marsarm.telemetry.schema import (
    ROS_NAME,
    ArmNames,
    Field,
    Layout,
    arm_names,
    is_tool_index,
    packet_layout,
    strip_annotated,
)
from marsarm.telemetry.topics import PACKET_TOPICS, Topic
from sim.params import nominal_params

IMPORT_PREFIX: Final = "/imported/"
"""Prefix of the topics that flight software does not have."""
CUSTOM_NAME: Final = re.compile(r"/imported/([a-z](?:_?[a-z0-9]+)*)\.(\w+)")
UNIT_OF_DTYPE: Final = {"|b1": "bool"}
SWITCHES: Final = "/sensors.switch_closed"
TOPICS: Final[dict[str, Topic]] = {topic.name: topic for topic, _ in PACKET_TOPICS}


@dataclass(frozen=True, slots=True)
class ChannelTarget:
    """Field of a message to which columns are mapped."""

    topic: str
    field: Field
    unit: str | None
    """Unit in the log; None for a member of an enumeration."""
    members: Mapping[str, int] | None = None
    """Names of the values; None for numbers and flags."""

    @property
    def name(self) -> str:
        """Name in a mapping."""
        return f"{self.topic}.{self.field.name}"

    def member(self, word: str) -> int | None:
        """Return the value of a member of the enumeration; case does not matter; None if there is none."""
        members = self.members or {}
        name = match_name(word, members)
        return None if name is None else members[name]

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(np.prod(self.field.shape or ()))

    @property
    def columns_text(self) -> str:
        """Description of the columns, for messages."""
        match self.size, self.field.shape:
            case 1, _:
                return "one"
            case 5, _:
                return f"5, one for each joint: {', '.join(joint.name for joint in Joint)}"
            case size, _ if self.name == SWITCHES:
                return f"{size}, one for each switch: {', '.join(_nominal_names().switches)}"
            case 3, _:
                return "3: x, y, z"
            case size, shape:
                return f"{size}, row by row of {shape}"


def _nominal_names() -> ArmNames:
    return arm_names(nominal_params())


@cache
def topic_layout(name: str) -> Layout:
    """Return the layout of a flight topic, as the recorder writes it."""
    return packet_layout(TOPICS[name].packet, TOPICS[name].field_names, _nominal_names())


@cache
def known_targets() -> dict[str, ChannelTarget]:
    """Return every flight channel by name."""
    found = {}
    for topic in TOPICS.values():
        hints = get_type_hints(topic.packet, include_extras=True)
        for field in topic_layout(topic.name).fields:
            kind = strip_annotated(hints[field.name])
            members: Mapping[str, int] | None = None
            if isinstance(kind, type) and issubclass(kind, IntEnum):
                members = {member.name: member.value for member in kind}
            if is_tool_index(hints[field.name]):
                members = {tool: k for k, tool in enumerate(_nominal_names().tools)}
            unit = None if members else UNIT_OF_DTYPE.get(field.kind) or unit_of(field.name)
            target = ChannelTarget(topic.name, field, unit, members)
            found[target.name] = target
    return found


def custom_target(name: str, columns: int, unit: str, single: bool) -> ChannelTarget | str:
    """Return a custom channel, or a sentence that says why the name is wrong.

    Args:
        name: Name of the channel, /imported/NAME.FIELD.
        columns: Number of columns.
        unit: Unit in the table.
        single: Whether the field is a single number, not an array.
    """
    match = CUSTOM_NAME.fullmatch(name)
    if match is None or not ROS_NAME.fullmatch(match[2].lower()):
        return "write /imported/NAME.FIELD, words of a-z and 0-9 joined by one _, as /imported/arm.speed_m_s"
    if f"/{match[1]}" in TOPICS:
        name = match[1]
        return f"{IMPORT_PREFIX}{name} is reserved for an incomplete /{name}; choose another name"
    field = match[2]
    kept_unit = unit_of(field) or ("bool" if unit == "bool" else "1")
    if unit not in conversions(kept_unit):
        return f"ends in {kept_unit}, not in what {unit} is kept in; write {_with_unit_suffix(field, unit)}"
    kind = {"bool": "|b1", "count": "<i8", "cycle": "<i8"}.get(kept_unit, "<f8")
    return ChannelTarget(
        f"{IMPORT_PREFIX}{match[1]}", Field(field, kind, None if single else (columns,)), kept_unit
    )


def conversions(kept_unit: str) -> dict[str, Conversion]:
    """Return the units of a table that convert to a unit of the log."""
    return UNIT_CONVERSIONS.get(kept_unit, {kept_unit: Conversion()})


def _with_unit_suffix(field: str, unit: str) -> str:
    """Replace the suffix of a field by that of a unit."""
    words = field.split("_")
    while len(words) > 1 and words[-1] in UNIT_SYMBOLS:
        words.pop()
    kept_unit = next(kept_unit for kept_unit, known in UNIT_CONVERSIONS.items() if unit in known)
    suffix = {"degC": "C", "N m": "Nm", "1": "share", "cycle": "cycles"}.get(kept_unit, kept_unit)
    return "_".join([*words, suffix.replace("/", "_")])
