"""Every channel of a log, known before its first cycle: what the recorder announces and the header says."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from mcap.records import Channel, Schema

from ground.telemetry.events import CommandEntry, Entry, EvrEntry
from ground.telemetry.format import COMMAND_TOPIC, DERIVED_KEY, EVR_TOPIC, LAYOUT_KEY, TRUTH_KEY, TRUTH_TEXT
from ground.telemetry.ros_text import full_text
from ground.telemetry.schema import Layout, definition, layout_of
from ground.telemetry.standard import FIXED_FRAMES, FRAMES, JOINT_STATES, SHAPES
from ground.telemetry.topics import PACKET_TOPICS

LOG_LINES: Final = "/rosout"
STANDARD: Final = {
    JOINT_STATES: (
        "sensor_msgs/msg/JointState",
        "/joint and /sensors: outputs as believed, torques from currents",
    ),
    FRAMES: ("tf2_msgs/msg/TFMessage", "/joint: outputs as believed, links rigid"),
    FIXED_FRAMES: ("tf2_msgs/msg/TFMessage", "the parameters"),
    SHAPES: ("visualization_msgs/msg/MarkerArray", "the parameters: shapes of the collision check"),
    LOG_LINES: ("rcl_interfaces/msg/Log", "/evr"),
}
"""Schema of each derived channel, and what it was computed from."""


@dataclass(frozen=True, slots=True)
class Announced:
    """One channel; the layout is None where messages have no fixed one."""

    id: int
    topic: str
    schema: str
    text: bytes
    metadata: Mapping[str, str]
    layout: Layout | None = None


def all_channels() -> tuple[Announced, ...]:
    """All channels, flight first."""
    packets = [
        (topic.name, topic.packet, layout_of(topic.packet, topic.field_names), topic.is_truth)
        for topic, _ in PACKET_TOPICS
    ]
    lines: list[tuple[str, type[Entry]]] = [(EVR_TOPIC, EvrEntry), (COMMAND_TOPIC, CommandEntry)]
    found: list[Announced] = []
    for topic, kind, layout, is_truth in packets:
        metadata = {LAYOUT_KEY: layout.to_json()}
        if is_truth:
            metadata[TRUTH_KEY] = TRUTH_TEXT
        text = definition(kind.__doc__, layout.ros_text)
        found.append(Announced(len(found) + 1, topic, own_schema(kind.__name__), text, metadata, layout))
    for topic, entry in lines:
        text = definition(entry.__doc__, entry.ros_text())
        found.append(Announced(len(found) + 1, topic, own_schema(entry.__name__), text, {}))
    for topic, (schema, source) in STANDARD.items():
        found.append(
            Announced(len(found) + 1, topic, schema, full_text(schema), {DERIVED_KEY: f"from {source}"})
        )
    return tuple(found)


def header_text(channels: tuple[Announced, ...]) -> str:
    """The channels as the header holds them: a JSON object by topic."""
    return json.dumps(
        {
            one.topic: {
                "id": one.id,
                "schema": one.schema,
                "layout": None if one.layout is None else json.loads(one.layout.to_json()),
                "truth": TRUTH_KEY in one.metadata,
                "derived": DERIVED_KEY in one.metadata,
            }
            for one in channels
        }
    )


def records_of(channels: tuple[Announced, ...]) -> tuple[list[Schema], list[Channel]]:
    """Schema and channel records; channels of one schema share it."""
    texts = {one.schema: one.text for one in channels}
    ids = {name: k + 1 for k, name in enumerate(texts)}
    schemas = [Schema(id=ids[name], name=name, encoding="ros2msg", data=text) for name, text in texts.items()]
    return schemas, [
        Channel(
            id=one.id,
            topic=one.topic,
            message_encoding="cdr",
            schema_id=ids[one.schema],
            metadata=dict(one.metadata),
        )
        for one in channels
    ]


def own_schema(name: str) -> str:
    """What a schema of ours is called in a log."""
    return f"marsarm/msg/{name}"
