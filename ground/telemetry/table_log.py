"""Writes a log whose messages are known beforehand: those of a table that was imported."""

import json
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
    header_crc32,
)
from ground.telemetry.schema import Layout, definition

CHUNK_BYTES: Final = 1 << 18
TRUTH: Final = "the plant's own state; flight software never sees it"


@dataclass(frozen=True, slots=True, eq=False)
class Series:
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
    series: Sequence[Series],
    commands: Sequence[tuple[int, Command]] | None,
) -> None:
    """Write a whole log, messages in order of time; without `commands` it has no channel for them.

    Raises:
        OSError: the disk is full or gone.
    """
    writer = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True)
    header = {**header, CHANNELS_KEY: json.dumps(_channels(series, commands is not None))}
    writer.start(profile="", library="marsarm")
    writer.add_metadata(FORMAT_RECORD, {"version": FORMAT, "header_crc32": header_crc32(header)})
    writer.add_metadata(HEADER_RECORD, header)
    entries = [(tick, command_entry(tick, command).encode()) for tick, command in commands or ()]
    bodies: list[Any] = [[body for _, body in entries]] if commands is not None else []
    ticks: list[Any] = [[tick for tick, _ in entries]] if commands is not None else []
    ids = [_command_channel(writer)] if commands is not None else []
    for one in series:
        ids.append(_packet_channel(writer, one))
        bodies.append(np.ascontiguousarray(one.data))
        ticks.append(one.ticks)
    for which, sequence, tick in _in_order(ticks):
        time_ns, body = tick * TICK_NS, bodies[which][sequence]
        writer.add_message(ids[which], time_ns, bytes(body), time_ns, sequence)
    writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself


def _in_order(ticks: Sequence[Any]) -> Any:
    """Which series, which of its messages, and the tick; by tick, and in a tick by series."""
    which = np.concatenate([np.full(len(one), k, np.int64) for k, one in enumerate(ticks)])
    sequence = np.concatenate([np.arange(len(one)) for one in ticks])
    tick = np.concatenate([np.asarray(one, np.int64) for one in ticks])
    order = np.lexsort((sequence, which, tick))
    return zip(which[order].tolist(), sequence[order].tolist(), tick[order].tolist(), strict=True)


def _channels(series: Sequence[Series], has_commands: bool) -> dict[str, Any]:
    """What the header says of each topic, so that a reader needs no schema record."""
    names = ([COMMAND_TOPIC] if has_commands else []) + [one.topic for one in series]
    told = [(_name(CommandEntry.__name__), None, False)] if has_commands else []
    told += [(_name(one.schema), json.loads(one.layout.to_json()), one.is_truth) for one in series]
    return {
        topic: {"id": k + 1, "schema": schema, "layout": layout, "truth": truth, "derived": False}
        for k, (topic, (schema, layout, truth)) in enumerate(zip(names, told, strict=True))
    }


def _command_channel(writer: Writer) -> int:
    text = definition(CommandEntry.__doc__, CommandEntry.ros_text())
    schema = writer.register_schema(_name(CommandEntry.__name__), "ros2msg", text)
    return writer.register_channel(COMMAND_TOPIC, "cdr", schema, {})


def _packet_channel(writer: Writer, one: Series) -> int:
    metadata = {LAYOUT_KEY: one.layout.to_json()} | ({TRUTH_KEY: TRUTH} if one.is_truth else {})
    text = definition(one.doc, one.layout.ros_text)
    return writer.register_channel(
        one.topic, "cdr", writer.register_schema(_name(one.schema), "ros2msg", text), metadata
    )


def _name(schema: str) -> str:
    return f"marsarm/msg/{schema}"
