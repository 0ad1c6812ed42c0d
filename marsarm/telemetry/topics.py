"""Topics of a log, derived from the annotations of CycleRecord, and their form in the header and in MCAP."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from fnmatch import fnmatchcase
from io import FileIO
from itertools import count
from typing import Any, BinaryIO, Final, get_origin, get_type_hints

from mcap.records import Channel, Metadata, Schema

from marsarm.telemetry.events import CommandEntry, EvrEntry, LogEntry
from marsarm.telemetry.format import (
    CHANNELS_KEY,
    CHUNK_CYCLES,
    COMMAND_TOPIC,
    EVR_TOPIC,
    LAYOUT_KEY,
    TRUTH_KEY,
    TRUTH_TEXT,
    header_records,
)
from marsarm.telemetry.log_writer import ChunkWriter
from marsarm.telemetry.schema import ArmNames, Layout, packet_layout, ros_definition, strip_optional
from sim.record import CycleRecord


def channel_name(topic: str, field: str) -> str:
    """Return the name of the channel of a field."""
    return f"{topic}.{field}"


def channel_matches(topic: str, field: str, pattern: str) -> bool:
    """Return whether a pattern matches a channel as /topic.field or /topic/field; case matters."""
    spellings = (channel_name(topic, field), f"{topic}/{field}")
    return any(fnmatchcase(spelling, pattern) for spelling in spellings)


@dataclass(frozen=True, slots=True)
class Topic:
    """Topic: its name, the dotted path of its packet in a CycleRecord, and its recorded fields."""

    name: str
    path: str
    packet: type
    field_names: tuple[str, ...]

    @property
    def is_truth(self) -> bool:
        """True if `sim` defines the packet: flight software cannot see it."""
        return self.packet.__module__.split(".")[0] == "sim"


def topics_in(owner: type, path: str = "") -> Iterator[Topic]:
    """Yield the topics of a packet type: one for its plain fields, and one for each dataclass in it.

    Tuples are left out, since they hold commands and EVRs, which are separate messages.
    """
    hints = get_type_hints(owner, include_extras=True)
    types = {f.name: strip_optional(hints[f.name]) for f in fields(owner)}
    plain = tuple(n for n, kind in types.items() if not is_dataclass(kind) and get_origin(kind) is not tuple)
    if path and plain:
        yield Topic("/" + path.rpartition(".")[2], path, owner, plain)
    for name, kind in types.items():
        if is_dataclass(kind) and isinstance(kind, type):
            yield from topics_in(kind, f"{path}.{name}".lstrip("."))


# The tick, the only plain field of CycleRecord, has no topic: it is the log time of every message.
PACKET_TOPICS: Final = {topic.name: topic for topic in topics_in(CycleRecord)}
ENTRIES: Final[dict[str, type[LogEntry]]] = {EVR_TOPIC: EvrEntry, COMMAND_TOPIC: CommandEntry}


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """Specification of a channel; the layout is None if its messages have no fixed layout."""

    id: int
    topic: str
    schema: str
    text: bytes
    layout: Layout | None = None
    is_truth: bool = False
    """True for the plant's own state."""

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata in the record of the channel."""
        layout = {} if self.layout is None else {LAYOUT_KEY: self.layout.to_json()}
        return layout | ({TRUTH_KEY: TRUTH_TEXT} if self.is_truth else {})

    @property
    def is_flight(self) -> bool:
        """True if a reader takes it; logs of 0.3 also have channels for other tools."""
        return self.topic in ENTRIES or self.layout is not None


def layout_spec(
    number: int, topic: str, kind: str, doc: str | None, layout: Layout, is_truth: bool
) -> TopicSpec:
    """Return the channel of messages with a layout; `kind` and `doc` name and describe their schema."""
    text = ros_definition(doc, layout.ros_text)
    return TopicSpec(number, topic, f"marsarm/msg/{kind}", text, layout, is_truth)


def topic_specs(arm: ArmNames) -> tuple[TopicSpec, ...]:
    """Return all channels of an arm with these tools and switches."""
    number = count(1)
    packets = [
        layout_spec(
            next(number),
            topic.name,
            topic.packet.__name__,
            topic.packet.__doc__,
            packet_layout(topic.packet, topic.field_names, arm),
            topic.is_truth,
        )
        for topic in PACKET_TOPICS.values()
    ]
    lines = [
        TopicSpec(next(number), topic, f"marsarm/msg/{entry.__name__}", entry.ros_definition())
        for topic, entry in ENTRIES.items()
    ]
    return (*packets, *lines)


def encode_topics(channels: tuple[TopicSpec, ...]) -> str:
    """Encode the channels for the header: a JSON object by topic."""
    return json.dumps(
        {
            one.topic: {
                "id": one.id,
                "schema": one.schema,
                "layout": None if one.layout is None else json.loads(one.layout.to_json()),
                "truth": one.is_truth,
            }
            for one in channels
        }
    )


def decode_topics(header: Mapping[str, str]) -> tuple[TopicSpec, ...]:
    """Return the flight channels that a header lists, by rising number; comments of definitions are lost.

    A damaged header raises KeyError, TypeError, AttributeError or ValueError.
    """
    listed = json.loads(header[CHANNELS_KEY])
    specs = sorted((_decode_topic(*one) for one in listed.items()), key=lambda one: one.id)
    return tuple(one for one in specs if one.is_flight)


def _decode_topic(topic: str, about: Mapping[str, Any]) -> TopicSpec:
    layout = None if about["layout"] is None else Layout.from_json(json.dumps(about["layout"]))
    if topic in ENTRIES:
        text = ENTRIES[topic].ros_definition()
    else:
        text = ros_definition(None, layout.ros_text if layout else "")
    return TopicSpec(int(about["id"]), topic, str(about["schema"]), text, layout, bool(about["truth"]))


def spec_of_channel(channel: Channel, schema: Schema) -> TopicSpec:
    """Return the specification of a channel from its records; errors as in `decode_topics`."""
    about = channel.metadata
    layout = Layout.from_json(about[LAYOUT_KEY]) if LAYOUT_KEY in about else None
    return TopicSpec(channel.id, channel.topic, schema.name, schema.data, layout, TRUTH_KEY in about)


def mcap_records(channels: tuple[TopicSpec, ...]) -> tuple[list[Schema], list[Channel]]:
    """Return schema and channel records; channels of equal schema share one record."""
    texts = {one.schema: one.text for one in channels}
    ids = {name: k + 1 for k, name in enumerate(texts)}
    schemas = [Schema(id=ids[name], name=name, encoding="ros2msg", data=text) for name, text in texts.items()]
    return schemas, [
        Channel(
            id=one.id,
            topic=one.topic,
            message_encoding="cdr",
            schema_id=ids[one.schema],
            metadata=one.metadata,
        )
        for one in channels
    ]


def begin_log(
    file: FileIO | BinaryIO,
    header: Mapping[str, str],
    channels: tuple[TopicSpec, ...],
    more: Sequence[Metadata] = (),
    chunk_cycles: int = CHUNK_CYCLES,
) -> ChunkWriter:
    """Begin a log with a header, more metadata, and channels; OSError if the disk is full or gone."""
    metadata = [*header_records({**header, CHANNELS_KEY: encode_topics(channels)}), *more]
    return ChunkWriter(file, metadata, *mcap_records(channels), chunk_cycles)
