"""The channels of a mapping as messages: whole packets under our topics, incomplete ones under their own."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ground.telemetry.imports.log_file import TopicMessages
from ground.telemetry.imports.mapping import TICK, MappedChannel, TableMapping
from ground.telemetry.imports.table import InputColumn, InputTable
from ground.telemetry.imports.targets import IMPORT_PREFIX, TOPICS, topic_layout
from ground.telemetry.imports.times import Cycles, RowSelection, check_grid, cycles_of, interpolate, pick_rows
from ground.telemetry.imports.values import channel_values, read_columns
from ground.telemetry.schema import ENCAPSULATION, Layout


@dataclass(frozen=True, slots=True)
class IncompleteTopic:
    """A topic of ours that the mapping gives a part of."""

    topic: str
    kept_as: str
    fields: tuple[str, ...]
    """Those that would make it whole."""


def incomplete_topics(mapping: TableMapping) -> tuple[IncompleteTopic, ...]:
    """Which of our topics are incomplete, and what they lack."""
    found = []
    for topic, channels in _group_by_topic(mapping):
        if topic in TOPICS:
            given = {channel.target.field.name for channel in channels}
            missing = tuple(name for name in TOPICS[topic].field_names if name not in given)
            if missing:
                found.append(IncompleteTopic(topic, IMPORT_PREFIX + topic[1:], missing))
    return tuple(found)


def build_topics(table: InputTable, mapping: TableMapping, cells: int) -> tuple[TopicMessages, ...]:
    """Every topic with its messages, none with more numbers than `cells`.

    Raises:
        BadImport: something in the table is not as the mapping says.
    """
    cycles = cycles_of(table, mapping.time)
    check_grid(table, mapping.time, cycles)
    incomplete = {one.topic: one.kept_as for one in incomplete_topics(mapping)}
    return tuple(
        _build_topic(table, mapping, cycles, topic, incomplete.get(topic, topic), channels, cells)
        for topic, channels in _group_by_topic(mapping)
    )


def _group_by_topic(mapping: TableMapping) -> Iterator[tuple[str, list[MappedChannel]]]:
    ordered = sorted(mapping.channels, key=lambda channel: channel.target.topic)
    for topic, channels in groupby(ordered, key=lambda channel: channel.target.topic):
        yield topic, list(channels)


def _build_topic(
    table: InputTable,
    mapping: TableMapping,
    cycles: Cycles,
    topic: str,
    name: str,
    channels: list[MappedChannel],
    cells: int,
) -> TopicMessages:
    columns = [read_columns(table, channel) for channel in channels]
    rows = _complete_rows(table, topic, [column for each in columns for column in each])
    most = cells // sum(channel.target.size for channel in channels)
    chosen = pick_rows(table, mapping.time, cycles, rows, most)
    if name == topic and topic in TOPICS:
        layout = topic_layout(topic)
    else:
        layout = Layout(tuple(channel.target.field for channel in channels))
    data = np.zeros(chosen.ticks.size, layout.dtype)
    data.view(np.uint8).reshape(data.size, -1)[:, : len(ENCAPSULATION)] = list(ENCAPSULATION)
    for channel, each in zip(channels, columns, strict=True):
        values = channel_values(table, channel, each, rows)
        if channel.constant is TICK or isinstance(channel.constant, str):
            data[channel.target.field.name] = chosen.ticks
        else:
            held = RowSelection(chosen.ticks, chosen.rows, None) if channel.target.members else chosen
            data[channel.target.field.name] = interpolate(values, held)
    return TopicMessages(
        topic=name,
        schema=_schema(name, topic),
        doc=_doc(name, topic),
        layout=layout,
        is_truth=topic in TOPICS and TOPICS[topic].is_truth,
        ticks=chosen.ticks,
        data=data,
    )


def _complete_rows(table: InputTable, topic: str, columns: list[InputColumn]) -> NDArray[np.int64]:
    """The rows in which a topic has a message: those with a value in all of its columns."""
    if not columns:
        return np.arange(table.rows)
    given = np.stack([column.given for column in columns])
    some = given.any(axis=0)
    part = np.flatnonzero(some & ~given.all(axis=0))
    if part.size:
        row = int(part[0])
        absent = columns[int(np.flatnonzero(~given[:, row])[0])].name
        there = columns[int(np.flatnonzero(given[:, row])[0])].name
        what = f"has no value, but {there!r} has; a message of {topic} needs all of its columns, or none"
        raise table.wrong(what, row, absent)
    if not some.any():
        raise table.wrong(
            f"no row has a value for {topic}; leave it out of the mapping", column=columns[0].name
        )
    return np.flatnonzero(some)


def _schema(name: str, topic: str) -> str:
    if name in TOPICS:
        return TOPICS[name].packet.__name__
    words = name.removeprefix(IMPORT_PREFIX).split("_")
    return "Imported" + "".join(word.capitalize() for word in words)


def _doc(name: str, topic: str) -> str:
    if name in TOPICS:
        return TOPICS[name].packet.__doc__ or ""
    if topic in TOPICS:
        return f"The part of {topic} that a table had."
    return "Of a table, and of no packet of ours."
