"""The channels of a mapping as messages: whole packets under our topics, incomplete ones under their own."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ground.telemetry.imports.mapping import TICK, Channel, Mapping
from ground.telemetry.imports.table import Column, Table
from ground.telemetry.imports.targets import IMPORTED, TOPICS, layout_of_topic
from ground.telemetry.imports.times import Cycles, Picked, between, check_grid, cycles_of, picked
from ground.telemetry.imports.values import columns_of, values_of
from ground.telemetry.schema import ENCAPSULATION, Layout
from ground.telemetry.table_log import Series


@dataclass(frozen=True, slots=True)
class Lacking:
    """A topic of ours that the mapping gives a part of."""

    topic: str
    kept_as: str
    fields: tuple[str, ...]
    """Those that would make it whole."""


def lacking(mapping: Mapping) -> tuple[Lacking, ...]:
    """Which of our topics are incomplete, and what they lack."""
    found = []
    for topic, channels in _by_topic(mapping):
        if topic in TOPICS:
            given = {channel.target.field.name for channel in channels}
            missing = tuple(name for name in TOPICS[topic].field_names if name not in given)
            if missing:
                found.append(Lacking(topic, IMPORTED + topic[1:], missing))
    return tuple(found)


def series_of(table: Table, mapping: Mapping, cells: int) -> tuple[Series, ...]:
    """Every topic with its messages, none with more numbers than `cells`.

    Raises:
        BadImport: something in the table is not as the mapping says.
    """
    cycles = cycles_of(table, mapping.time)
    check_grid(table, mapping.time, cycles)
    incomplete = {one.topic: one.kept_as for one in lacking(mapping)}
    return tuple(
        _series(table, mapping, cycles, topic, incomplete.get(topic, topic), channels, cells)
        for topic, channels in _by_topic(mapping)
    )


def _by_topic(mapping: Mapping) -> Iterator[tuple[str, list[Channel]]]:
    ordered = sorted(mapping.channels, key=lambda channel: channel.target.topic)
    for topic, channels in groupby(ordered, key=lambda channel: channel.target.topic):
        yield topic, list(channels)


def _series(
    table: Table, mapping: Mapping, cycles: Cycles, topic: str, name: str, channels: list[Channel], cells: int
) -> Series:
    columns = [columns_of(table, channel) for channel in channels]
    rows = _given_rows(table, topic, [column for each in columns for column in each])
    most = cells // sum(channel.target.size for channel in channels)
    chosen = picked(table, mapping.time, cycles, rows, most)
    if name == topic and topic in TOPICS:
        layout = layout_of_topic(topic)
    else:
        layout = Layout(tuple(channel.target.field for channel in channels))
    data = np.zeros(chosen.ticks.size, layout.dtype)
    data.view(np.uint8).reshape(data.size, -1)[:, : len(ENCAPSULATION)] = list(ENCAPSULATION)
    for channel, each in zip(channels, columns, strict=True):
        values = values_of(table, channel, each, rows)
        if channel.constant is TICK or isinstance(channel.constant, str):
            data[channel.target.field.name] = chosen.ticks
        else:
            held = Picked(chosen.ticks, chosen.rows, None) if channel.target.members else chosen
            data[channel.target.field.name] = between(values, held)
    return Series(
        topic=name,
        schema=_schema(name, topic),
        doc=_doc(name, topic),
        layout=layout,
        is_truth=topic in TOPICS and TOPICS[topic].is_truth,
        ticks=chosen.ticks,
        data=data,
    )


def _given_rows(table: Table, topic: str, columns: list[Column]) -> NDArray[np.int64]:
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
    words = name.removeprefix(IMPORTED).split("_")
    return "Imported" + "".join(word.capitalize() for word in words)


def _doc(name: str, topic: str) -> str:
    if name in TOPICS:
        return TOPICS[name].packet.__doc__ or ""
    if topic in TOPICS:
        return f"The part of {topic} that a table had."
    return "Of a table, and of no packet of ours."
