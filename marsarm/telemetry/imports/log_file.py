"""Writer of a log from an imported table, whose messages are all known in advance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from marsarm.telemetry.events import CommandEntry, command_entry
from marsarm.telemetry.format import (
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
from marsarm.telemetry.schema import Layout, ros_definition
from marsarm.telemetry.topics import TopicSpec, encode_topics, schema_name

CHUNK_BYTES: Final = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class TopicMessages:
    """Messages of one topic."""

    topic: str
    schema: str
    doc: str
    layout: Layout
    is_truth: bool
    ticks: NDArray[np.int64]
    """Tick of each message, rising, shape (n,)."""
    data: NDArray[np.void]
    """Messages in the type of the layout, shape (n,)."""


def write_table_log(
    file: BinaryIO,
    header: Mapping[str, str],
    series: Sequence[TopicMessages],
    commands: Sequence[tuple[int, Command]] | None,
) -> None:
    """Write a closed log, messages in order of time; if `commands` is None, the log has no channel for them.

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
    for k, sequence, tick in _sort_messages(ticks):
        time_ns, body = tick * TICK_NS, bodies[k][sequence]
        writer.add_message(ids[k], time_ns, bytes(body), time_ns, sequence)
    writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself


def _sort_messages(ticks: Sequence[Any]) -> Any:
    """Return series, message in the series, and tick, of all messages in order of tick, then of series."""
    series = np.concatenate([np.full(len(one), k, np.int64) for k, one in enumerate(ticks)])
    sequence = np.concatenate([np.arange(len(one)) for one in ticks])
    tick = np.concatenate([np.asarray(one, np.int64) for one in ticks])
    order = np.lexsort((sequence, series, tick))
    return zip(series[order].tolist(), sequence[order].tolist(), tick[order].tolist(), strict=True)


def _topic_specs(series: Sequence[TopicMessages], has_commands: bool) -> tuple[TopicSpec, ...]:
    """Return the channels, commands first."""
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
