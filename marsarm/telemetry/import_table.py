"""Import of a table: its columns become the messages of a log, in the cycles of 64 Hz."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import merge
from itertools import chain, groupby, repeat
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Mode
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.import_mapping import (
    IMPORT_PREFIX,
    GridTime,
    MappedChannel,
    MappingFile,
    map_channels,
    read_params,
    stored_reference,
    topic_layout,
)
from marsarm.telemetry.import_times import (
    Rows,
    RowSelection,
    RowTimes,
    check_grid,
    interpolate,
    pick_rows,
    row_times,
)
from marsarm.telemetry.recorder import IMPORT, SESSION, commands_header, start_header, versions_header
from marsarm.telemetry.schema import ENCAPSULATION, Layout
from marsarm.telemetry.topics import PACKET_TOPICS, TopicSpec, begin_log, layout_spec
from simgap.common.console import pluralize
from simgap.common.errors import RobotError
from simgap.common.files import atomic_write, check_distinct_files, check_output, file_sha256
from simgap.common.progress import GUESS, Progress
from simgap.common.report import ReportTable
from simgap.common.toml import parse_record, read_toml
from simgap.files.columns import Column
from simgap.files.log_file import LogFile, open_log

UNKNOWN_CPU: Final = "[]"
"""Value of `cpu` in the header: the processor that computed the table is unknown."""
MAX_EXACT_INT: Final = 1 << 53
"""Limit up to which every integer is exact as a float."""


@dataclass(frozen=True, slots=True, eq=False)
class TopicMessages:
    """Messages of one topic."""

    spec: TopicSpec
    layout: Layout
    ticks: Rows
    """Tick of each message, rising, shape (n,)."""
    data: NDArray[np.void]
    """Messages in the type of the layout, shape (n,)."""
    missing_fields: tuple[str, ...]
    """Fields of the flight topic that the mapping lacks."""


@dataclass(frozen=True, slots=True, eq=False)
class ImportedLog:
    """Log of a table, in memory."""

    rows: int
    rows_moved: int
    """Places where the file was not in order of time."""
    series: tuple[TopicMessages, ...]
    header: dict[str, str]


def import_table(table: Path, mapping: Path, log: Path, progress: Progress) -> ImportedLog:
    """Write the log of a table; BadRequest if its path is wrong, RobotError if table or mapping is."""
    check_distinct_files({"table": table, "mapping": mapping, "OUT": log})
    check_output(log, (".mcap",), "OUT")
    progress(0.0, GUESS, "reading the table")
    made = convert_table(table, mapping)
    progress(0.5, GUESS, "writing the log")
    with atomic_write(log, "OUT") as file:
        write_table_log(file, made)
    return made


def convert_table(table: Path, mapping: Path) -> ImportedLog:
    """Convert a table to a log in memory; RobotError if the table or the mapping is wrong."""
    file = parse_record(MappingFile, read_toml(mapping), mapping)
    params, mapped = read_params(mapping, file), map_channels(mapping, file)
    columns = [name for one in mapped for name in one.columns]
    if not columns:
        raise RobotError(f"{mapping}: channels: none has columns; there is nothing to take from the table")
    clock = [file.time.column] if file.time.column else []
    log = open_log(table, [*columns, *([] if file.time.format else clock)], clock, file.csv)
    groups = [list(some) for _, some in groupby(sorted(mapped, key=_topic_of), key=_topic_of)]
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is refused, what was stays
        made = [_build_topic(log, file.time, channels, k + 1) for k, channels in enumerate(groups)]
    series, times = tuple(one for one, _ in made), made[0][1]
    about = {"table": str(table), "mapping": str(mapping)}
    about |= {"table_sha256": file_sha256(table), "mapping_sha256": file_sha256(mapping)}
    reference = stored_reference(file.reference, params)
    header = {
        **versions_header(),
        **({} if reference is None else start_header(params, Mode.DEPLOYED, reference)),
        **commands_header(()),
        **({} if file.session is None else {SESSION: json.dumps(file.session.model_dump())}),
        "cpu": UNKNOWN_CPU,
        "arm": file.arm,
        "seed": "unknown",
        "request": json.dumps({IMPORT: about}, sort_keys=True),
        "mjcf_sha256": "unknown",
    }
    moved = int(np.count_nonzero(np.diff(times.order) != 1))
    return ImportedLog(times.order.size, moved, series, header)


def _topic_of(channel: MappedChannel) -> str:
    return channel.target.topic


def _build_topic(
    log: LogFile, time: GridTime, channels: Sequence[MappedChannel], number: int
) -> tuple[TopicMessages, RowTimes]:
    """Build the messages of a topic, which becomes the channel with this number."""
    columns = [[log.numbers(name) for name in one.columns] for one in channels]
    names = [name for one in channels for name in one.columns]
    named = [*zip(names, chain.from_iterable(columns), strict=True)]
    topic = channels[0].target.topic
    if not named:
        raise RobotError(f"{log.path}: all of {topic} is constant; give a column of it, or leave it out")
    times = row_times(log, time, named[0][1])
    check_grid(times, time)
    rows = _complete_rows(times, topic, named)
    chosen = pick_rows(times, time, rows)
    given = {one.target.field.name for one in channels}
    fields = PACKET_TOPICS[topic].field_names if topic in PACKET_TOPICS else ()
    missing = tuple(name for name in fields if name not in given)
    is_whole = topic in PACKET_TOPICS and not missing
    layout = topic_layout(topic) if is_whole else Layout(tuple(one.target.field for one in channels))
    data = np.zeros(chosen.ticks.size, layout.dtype)
    data.view(np.uint8).reshape(data.size, -1)[:, : len(ENCAPSULATION)] = list(ENCAPSULATION)
    for one, some in zip(channels, columns, strict=True):
        if not one.columns and not one.constant:
            data[one.target.field.name] = chosen.ticks
            continue
        held = RowSelection(chosen.ticks, chosen.rows, None) if one.target.field.members else chosen
        values = _values(times, one, [column.value[times.order[rows]] for column in some], rows)
        data[one.target.field.name] = interpolate(values, held)
    name = topic if is_whole or topic not in PACKET_TOPICS else IMPORT_PREFIX + topic[1:]
    return TopicMessages(_spec(number, name, topic, layout), layout, chosen.ticks, data, missing), times


def _complete_rows(times: RowTimes, topic: str, columns: Sequence[tuple[str, Column]]) -> Rows:
    """Return the rows that have a value in all columns of a topic, in order of time, shape (k,)."""
    n = times.order.size
    for name, column in columns:
        if column.value.size != n:
            raise times.error_at(f"has {column.value.size} values, {columns[0][0]!r} has {n}", column=name)
        own_s, first_s = column.time_s, columns[0][1].time_s
        if own_s is not None and first_s is not None and not np.array_equal(own_s, first_s):
            raise times.error_at(
                f"has other times than {columns[0][0]!r}; map it to a topic of its own", column=name
            )
    masks = [np.ones(n, bool) if c.is_present is None else c.is_present[times.order] for _, c in columns]
    given = np.stack(masks)
    is_any = given.any(axis=0)
    partial = np.flatnonzero(is_any & ~given.all(axis=0))
    if partial.size:
        row = int(partial[0])
        name = columns[int(np.flatnonzero(~given[:, row])[0])][0]
        raise times.error_at(
            f"has no value; a message of {topic} needs all of its columns, or none", row, name
        )
    if not is_any.any():
        raise times.error_at(
            f"no row has a value for {topic}; leave it out of the mapping", column=columns[0][0]
        )
    return np.flatnonzero(is_any)


def _values(
    times: RowTimes, one: MappedChannel, columns: Sequence[NDArray[np.float64]], rows: Rows
) -> NDArray[Any]:
    """Convert the columns of a channel, or its constant, to the type of the log, shape (k, *shape of it)."""
    field, kind = one.target.field, np.dtype(one.target.field.kind)
    parts = []
    for k, read in enumerate(columns or [np.full(rows.size, value) for value in one.constant]):
        # a step that changes nothing is left out, so that every bit is kept
        values = read * one.factor[k] if one.factor[k] != 1.0 else read
        values = values + one.offset[k] if one.offset[k] != 0.0 else values
        is_bad, why = _misfits(one, read, values)
        if is_bad.any():
            row = int(np.argmax(is_bad))
            name = one.columns[k] if one.columns else ""
            raise times.error_at(f"{read[row]:.17g} {why}, for {one.target.name}", int(rows[row]), name)
        parts.append(np.rint(values).astype(kind) if kind.kind == "i" else values.astype(kind))
    return np.stack(parts, axis=1).reshape(rows.size, *(field.shape or ()))


def _misfits(
    one: MappedChannel, read: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], str]:
    """Return which values, (k,), a channel cannot hold, and why."""
    field = one.target.field
    if field.members is not None:
        listed = ", ".join(f"{number} {name}" for name, number in field.members.items())
        return ~np.isin(values, [*field.members.values()]), f"is none of {listed}"
    match field.kind:
        case "|b1":
            return (values != 0.0) & (values != 1.0), "is neither true nor false, 1 nor 0"
        case "<i8":
            is_broken = np.zeros(values.size, bool) if one.is_rounded else values != np.rint(values)
            return is_broken | ~(np.abs(values) <= MAX_EXACT_INT), "is no whole number that is exact"
    return np.isfinite(read) & ~np.isfinite(values), "is too large for its factor, offset and unit"


def _spec(number: int, name: str, topic: str, layout: Layout) -> TopicSpec:
    """Return the channel of a topic that has a name in the log."""
    is_truth = topic in PACKET_TOPICS and PACKET_TOPICS[topic].is_truth
    kind, doc = "Imported" + name.removeprefix(IMPORT_PREFIX).title().replace("_", ""), "Of a table."
    if name in PACKET_TOPICS:
        kind, doc = PACKET_TOPICS[name].packet.__name__, PACKET_TOPICS[name].packet.__doc__ or ""
    return layout_spec(number, name, kind, doc, layout, is_truth)


def write_table_log(file: BinaryIO, made: ImportedLog) -> None:
    """Write a closed log in order of time, without commands, which are unknown; OSError if that fails."""
    writer = begin_log(file, made.header, tuple(one.spec for one in made.series))
    messages = [zip(one.ticks.tolist(), repeat(one.spec.id), one.data, strict=False) for one in made.series]
    for tick, channel, message in merge(*messages, key=itemgetter(0)):
        writer.add(tick * TICK_NS, [(channel, message.tobytes())])
    writer.finish([])


def import_document(log: Path, made: ImportedLog) -> dict[str, Any]:
    """Collect an import."""
    return {
        "log": log,
        "rows": made.rows,
        "rows_moved": made.rows_moved,
        "topics": [
            {
                "topic": one.spec.topic,
                "messages": one.ticks.size,
                "first_tick": one.ticks[0],
                "last_tick": one.ticks[-1],
                "missing_ticks": one.ticks[-1] - one.ticks[0] + 1 - one.ticks.size,
                "missing_fields": one.missing_fields,
            }
            for one in made.series
        ],
    }


def import_parts(log: Path, made: ImportedLog) -> list[str | ReportTable]:
    """Show an import: a row for each topic, and the missing fields of incomplete topics."""
    topics = import_document(log, made)["topics"]
    rows = [[str(value) for key, value in one.items() if key != "missing_fields"] for one in topics]
    head = ("topic", "messages", "first tick", "last tick", "ticks without")
    moved = f"sorted    in {pluralize(made.rows_moved, 'place')} the file was not in order of time"
    return [
        ReportTable(head, rows, f"{log}: {pluralize(made.rows, 'row')}"),
        *([moved] if made.rows_moved else []),
        *(
            f"{one['topic']} is kept apart from flight topics, for it is incomplete; it lacks "
            f"{', '.join(one['missing_fields'])}"
            for one in topics
            if one["missing_fields"]
        ),
    ]
