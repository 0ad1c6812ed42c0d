"""Specification of every channel that the recorder writes, and its form in the header and in MCAP records."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from mcap.records import Channel, Schema

from marsarm.telemetry.events import CommandEntry, EvrEntry, LogEntry
from marsarm.telemetry.format import COMMAND_TOPIC, DERIVED_KEY, EVR_TOPIC, LAYOUT_KEY, TRUTH_KEY, TRUTH_TEXT
from marsarm.telemetry.ros_messages import (
    JOINT_STATES_TOPIC,
    MARKERS_TOPIC,
    ROBOT_DESCRIPTION_TOPIC,
    TF_STATIC_TOPIC,
    TF_TOPIC,
    ros_schema,
)
from marsarm.telemetry.schema import ArmNames, Layout, packet_layout, ros_definition
from marsarm.telemetry.topics import PACKET_TOPICS

ROSOUT_TOPIC: Final = "/rosout"
DERIVED_TOPICS: Final = {
    JOINT_STATES_TOPIC: (
        "sensor_msgs/msg/JointState",
        "/joint and /sensors: outputs as believed, torques from currents",
    ),
    TF_TOPIC: ("tf2_msgs/msg/TFMessage", "/joint: outputs as believed, links rigid"),
    TF_STATIC_TOPIC: ("tf2_msgs/msg/TFMessage", "the parameters"),
    MARKERS_TOPIC: ("visualization_msgs/msg/MarkerArray", "the parameters: shapes of the collision check"),
    ROSOUT_TOPIC: ("rcl_interfaces/msg/Log", "/evr"),
    ROBOT_DESCRIPTION_TOPIC: (
        "std_msgs/msg/String",
        "the parameters, and the scene of the run as it is drawn",
    ),
}
"""Schema and source of each derived channel."""


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """Specification of a channel; the layout is None if its messages have no fixed layout."""

    id: int
    topic: str
    schema: str
    text: bytes
    metadata: Mapping[str, str]
    layout: Layout | None = None


def topic_specs(arm: ArmNames) -> tuple[TopicSpec, ...]:
    """Return all channels of an arm with these tools and switches, flight channels first."""
    packets = [
        (topic.name, topic.packet, packet_layout(topic.packet, topic.field_names, arm), topic.is_truth)
        for topic, _ in PACKET_TOPICS
    ]
    lines: list[tuple[str, type[LogEntry]]] = [(EVR_TOPIC, EvrEntry), (COMMAND_TOPIC, CommandEntry)]
    found: list[TopicSpec] = []
    for topic, kind, layout, is_truth in packets:
        metadata = {LAYOUT_KEY: layout.to_json()}
        if is_truth:
            metadata[TRUTH_KEY] = TRUTH_TEXT
        text = ros_definition(kind.__doc__, layout.ros_text)
        found.append(TopicSpec(len(found) + 1, topic, schema_name(kind.__name__), text, metadata, layout))
    for topic, entry in lines:
        text = ros_definition(entry.__doc__, entry.ros_text())
        found.append(TopicSpec(len(found) + 1, topic, schema_name(entry.__name__), text, {}))
    for topic, (schema, source) in DERIVED_TOPICS.items():
        found.append(
            TopicSpec(len(found) + 1, topic, schema, ros_schema(schema), {DERIVED_KEY: f"from {source}"})
        )
    return tuple(found)


def encode_topics(channels: tuple[TopicSpec, ...]) -> str:
    """Encode the channels for the header: a JSON object by topic."""
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
            metadata=dict(one.metadata),
        )
        for one in channels
    ]


def schema_name(name: str) -> str:
    """Return the full name of a marsarm schema."""
    return f"marsarm/msg/{name}"
