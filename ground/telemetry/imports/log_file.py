"""Writes a log whose messages are known beforehand: those of a table that was imported."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from ground.telemetry.events import CommandEntry, command_entry
from ground.telemetry.format import (
    CHANNELS_KEY,
    COMMAND_TOPIC,
    FORMAT,
    FORMAT_RECORD,
    HEADER_RECORD,
    LAYOUT_KEY,
    TICK_NS,
    TRUTH_KEY,
    TRUTH_TEXT,
    header_crc32,
)
from ground.telemetry.schema import Layout, ros_definition
from ground.telemetry.topic_specs import TopicSpec, encode_topics, schema_name

CHUNK_BYTES: Final = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class TopicMessages:
    """The messages of one topic: `data` (n,) has the layout's type and is written as it is."""

    topic: str
    schema: str
    doc: str
    layout: Layout
    is_truth: bool
    ticks: NDArray[np.int64]
    """The cycle of each message, (n,), growing."""
    data: NDArray[np.void]


def write_table_log(
    file: BinaryIO,
    header: Mapping[str, str],
    series: Sequence[TopicMessages],
    commands: Sequence[tuple[int, Command]] | None,
) -> None:
    """Write a whole log, messages in order of time; without `commands` it has no channel for them.

    Raises:
        OSError: the disk is full or gone.
    """
    writer = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True)
    channels = _topic_specs(series, commands is not None)
    header = {**header, CHANNELS_KEY: encode_topics(channels)}
    writer.start(profile="", library="marsarm")
    writer.add_metadata(FORMAT_RECORD, {"version": FORMAT, "header_crc32": header_crc32(header)})
    writer.add_metadata(HEADER_RECORD, header)
    entries = [(tick, command_entry(tick, command).encode()) for tick, command in commands or ()]
    bodies: list[Any] = [[body for _, body in entries]] if commands is not None else []
    ticks: list[Any] = [[tick for tick, _ in entries]] if commands is not None else []
    ids = [_register_topic(writer, channel) for channel in channels]
    for one in series:
        bodies.append(np.ascontiguousarray(one.data))
        ticks.append(one.ticks)
    for which, sequence, tick in _sort_messages(ticks):
        time_ns, body = tick * TICK_NS, bodies[which][sequence]
        writer.add_message(ids[which], time_ns, bytes(body), time_ns, sequence)
    writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself


def _sort_messages(ticks: Sequence[Any]) -> Any:
    """Which series, which of its messages, and the tick; by tick, and in a tick by series."""
    which = np.concatenate([np.full(len(one), k, np.int64) for k, one in enumerate(ticks)])
    sequence = np.concatenate([np.arange(len(one)) for one in ticks])
    tick = np.concatenate([np.asarray(one, np.int64) for one in ticks])
    order = np.lexsort((sequence, which, tick))
    return zip(which[order].tolist(), sequence[order].tolist(), tick[order].tolist(), strict=True)


def _topic_specs(series: Sequence[TopicMessages], has_commands: bool) -> tuple[TopicSpec, ...]:
    """The channels, commands first."""
    found = []
    if has_commands:
        text = ros_definition(CommandEntry.__doc__, CommandEntry.ros_text())
        found.append(TopicSpec(1, COMMAND_TOPIC, schema_name(CommandEntry.__name__), text, {}))
    for one in series:
        metadata = {LAYOUT_KEY: one.layout.to_json()} | ({TRUTH_KEY: TRUTH_TEXT} if one.is_truth else {})
        text = ros_definition(one.doc, one.layout.ros_text)
        schema = schema_name(one.schema)
        found.append(TopicSpec(len(found) + 1, one.topic, schema, text, metadata, one.layout))
    return tuple(found)


def _register_topic(writer: Writer, channel: TopicSpec) -> int:
    schema = writer.register_schema(channel.schema, "ros2msg", channel.text)
    return writer.register_channel(channel.topic, "cdr", schema, dict(channel.metadata))
