"""Messages from the channels of a mapping: complete packets in flight topics, others in custom topics."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from marsarm.telemetry.imports.log_file import TopicMessages
from marsarm.telemetry.imports.mapping import TICK, MappedChannel, TableMapping
from marsarm.telemetry.imports.table import InputColumn, InputTable
from marsarm.telemetry.imports.targets import IMPORT_PREFIX, TOPICS, topic_layout
from marsarm.telemetry.imports.times import (
    Cycles,
    RowSelection,
    check_grid,
    cycles_of,
    interpolate,
    pick_rows,
)
from marsarm.telemetry.imports.values import channel_values, read_columns
from marsarm.telemetry.schema import ENCAPSULATION, Layout


@dataclass(frozen=True, slots=True)
class IncompleteTopic:
    """Flight topic for which the mapping has only some of the fields."""

    topic: str
    kept_as: str
    fields: tuple[str, ...]
    """Fields that the mapping lacks."""


def incomplete_topics(mapping: TableMapping) -> tuple[IncompleteTopic, ...]:
    """Find the flight topics that a mapping gives incompletely."""
    found = []
    for topic, channels in _group_by_topic(mapping):
        if topic in TOPICS:
            given = {channel.target.field.name for channel in channels}
            missing = tuple(name for name in TOPICS[topic].field_names if name not in given)
            if missing:
                found.append(IncompleteTopic(topic, IMPORT_PREFIX + topic[1:], missing))
    return tuple(found)


def build_topics(table: InputTable, mapping: TableMapping, cells: int) -> tuple[TopicMessages, ...]:
    """Build the messages of every topic.

    Args:
        cells: Limit of the numbers in one topic.

    Raises:
        BadImport: the table does not fit the mapping.
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
    max_messages = cells // sum(channel.target.size for channel in channels)
    chosen = pick_rows(table, mapping.time, cycles, rows, max_messages)
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
        schema=_schema(name),
        doc=_doc(name, topic),
        layout=layout,
        is_truth=topic in TOPICS and TOPICS[topic].is_truth,
        ticks=chosen.ticks,
        data=data,
    )


def _complete_rows(table: InputTable, topic: str, columns: list[InputColumn]) -> NDArray[np.int64]:
    """Return the rows that have a value in all columns of a topic, shape (k,)."""
    if not columns:
        return np.arange(table.rows)
    given = np.stack([column.given for column in columns])
    is_any = given.any(axis=0)
    partial = np.flatnonzero(is_any & ~given.all(axis=0))
    if partial.size:
        row = int(partial[0])
        absent = columns[int(np.flatnonzero(~given[:, row])[0])].name
        present = columns[int(np.flatnonzero(given[:, row])[0])].name
        what = f"has no value, but {present!r} has; a message of {topic} needs all of its columns, or none"
        raise table.error_at(what, row, absent)
    if not is_any.any():
        raise table.error_at(
            f"no row has a value for {topic}; leave it out of the mapping", column=columns[0].name
        )
    return np.flatnonzero(is_any)


def _schema(name: str) -> str:
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
