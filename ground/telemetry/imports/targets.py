"""What a column may be mapped to: our channels by name, and channels of the table's own."""

import re
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Final, get_type_hints

import numpy as np

from fsw.dictionary.enums import Joint, Switch
from ground.common.fields import UNIT_SYMBOLS, unit_of
from ground.telemetry.imports.units import UNIT_CONVERSIONS, Conversion
from ground.telemetry.schema import ROS_NAME, Field, Layout, packet_layout, strip_annotated
from ground.telemetry.topics import PACKET_TOPICS, Topic

IMPORT_PREFIX: Final = "/imported/"
"""Before the name of a topic that flight software does not have."""
CUSTOM_NAME: Final = re.compile(r"/imported/([a-z](?:_?[a-z0-9]+)*)\.(\w+)")
UNIT_OF_DTYPE: Final = {"|b1": "bool"}
TOPICS: Final[dict[str, Topic]] = {topic.name: topic for topic, _ in PACKET_TOPICS}


@dataclass(frozen=True, slots=True)
class ChannelTarget:
    """A field of a message."""

    topic: str
    field: Field
    unit: str | None
    """Of the house; None for the name of a member of `members`."""
    members: type[IntEnum] | None = None

    @property
    def name(self) -> str:
        """As a mapping names it."""
        return f"{self.topic}.{self.field.name}"

    def member(self, word: str) -> int | None:
        """The number of the member of this name, in capitals or not; None if there is none."""
        known = {} if self.members is None else self.members.__members__
        return known[word.upper()].value if word.upper() in known else None

    @property
    def size(self) -> int:
        """How many columns it takes."""
        return int(np.prod(self.field.shape or ()))

    @property
    def columns_text(self) -> str:
        """What the columns are, for a sentence."""
        match self.size, self.field.shape:
            case 1, _:
                return "one"
            case 5, _:
                return f"5, one for each joint: {', '.join(joint.name for joint in Joint)}"
            case 10, _:
                return f"10, one for each switch: {', '.join(switch.name for switch in Switch)}"
            case 3, _:
                return "3: x, y, z"
            case size, shape:
                return f"{size}, row by row of {shape}"


@cache
def topic_layout(name: str) -> Layout:
    """The layout of a topic of ours, the one that the recorder writes."""
    return packet_layout(TOPICS[name].packet, TOPICS[name].field_names)


@cache
def known_targets() -> dict[str, ChannelTarget]:
    """Every channel of ours, by name."""
    found = {}
    for topic in TOPICS.values():
        hints = get_type_hints(topic.packet, include_extras=True)
        for field in topic_layout(topic.name).fields:
            kind = strip_annotated(hints[field.name])
            members = kind if isinstance(kind, type) and issubclass(kind, IntEnum) else None
            unit = None if members else UNIT_OF_DTYPE.get(field.kind) or unit_of(field.name)
            target = ChannelTarget(topic.name, field, unit, members)
            found[target.name] = target
    return found


def custom_target(name: str, columns: int, unit: str, single: bool) -> ChannelTarget | str:
    """The channel of the table's own that this name is, or the sentence that says why it is none."""
    said = CUSTOM_NAME.fullmatch(name)
    if said is None or not ROS_NAME.fullmatch(said[2].lower()):
        return "write /imported/NAME.FIELD, words of a-z and 0-9 joined by one _, as /imported/arm.speed_m_s"
    if f"/{said[1]}" in TOPICS:
        return (
            f"{IMPORT_PREFIX}{said[1]} is for what there is of an incomplete /{said[1]}; choose another name"
        )
    field = said[2]
    house = unit_of(field) or ("bool" if unit == "bool" else "1")
    if unit not in conversions(house):
        return f"ends in {house}, not in what {unit} is kept in; write {_with_unit_suffix(field, unit)}"
    kind = {"bool": "|b1", "count": "<i8", "cycle": "<i8"}.get(house, "<f8")
    return ChannelTarget(
        f"{IMPORT_PREFIX}{said[1]}", Field(field, kind, None if single else (columns,)), house
    )


def conversions(house: str) -> dict[str, Conversion]:
    """The units that may be given for what is kept in this one."""
    return UNIT_CONVERSIONS.get(house, {house: Conversion()})


def _with_unit_suffix(field: str, unit: str) -> str:
    """The field with the suffix of this unit, in the place of another."""
    words = field.split("_")
    while len(words) > 1 and words[-1] in UNIT_SYMBOLS:
        words.pop()
    house = next(house for house, known in UNIT_CONVERSIONS.items() if unit in known)
    suffix = {"degC": "C", "N m": "Nm", "1": "share", "cycle": "cycles"}.get(house, house)
    return "_".join([*words, suffix.replace("/", "_")])
