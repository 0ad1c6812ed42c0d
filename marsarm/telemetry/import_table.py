"""Import of a table: its columns become sensors and drive of a log, in the cycles of 64 Hz."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Mode
from marsarm.telemetry.format import SENSOR_TOPIC, TICK_NS
from marsarm.telemetry.import_mapping import (
    Array,
    GridTime,
    MappedChannel,
    MappingFile,
    layout_of,
    map_channels,
    read_params,
    stored_reference,
)
from marsarm.telemetry.recorder import IMPORT, SESSION, commands_header, start_header, versions_header
from marsarm.telemetry.schema import ENCAPSULATION
from marsarm.telemetry.topics import PACKET_TOPICS, TopicSpec, begin_log, layout_spec
from simgap.common.console import pluralize
from simgap.common.errors import RobotError
from simgap.common.files import atomic_write, check_distinct_files, check_output, file_sha256
from simgap.common.progress import GUESS, Progress
from simgap.common.toml import parse_record, read_toml
from simgap.files.log_file import LogFile, open_log, read_times
from simgap.units import UNITS

UNKNOWN_CPU: Final = "[]"
"""Value of `cpu` in the header: the processor that computed the table is unknown."""
MAX_EXACT_INT: Final = 1 << 53
"""Limit up to which every integer is exact as a float."""
TOLERANCE_CYCLES: Final = 0.01
"""Largest distance of a row from its cycle with grid "exact"."""
MAX_INTERVAL_S: Final = 1.0
"""Longest time without a row that grid "linear" bridges."""
CYCLE_ROUNDING: Final = 1e-4
"""Share of a cycle by which a row may miss a cycle and still belong to it; stamps of today have 1e-5."""
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class TopicRows:
    """Rows of the table that have a value in each column of a topic."""

    path: Path
    row: Rows
    """Row of the file, shape (n,)."""
    time_s: Array
    """Rising times, shape (n,)."""
    values: Mapping[str, Array]
    """Values by column, shape (n,) each."""

    def error_at(self, what: str, row: int, column: str = "") -> RobotError:
        """Return an error that names file, row and column; row 1 is the first below the header."""
        place = f"row {self.row[row] + 1}" + (f", column {column!r}" if column else "")
        return RobotError(f"{self.path}: {place}: {what}")


@dataclass(frozen=True, slots=True, eq=False)
class TopicMessages:
    """Messages of one topic."""

    spec: TopicSpec
    ticks: Rows
    """Tick of each message, rising, shape (n,)."""
    data: NDArray[np.void]
    """Messages in the type of the layout, shape (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class ImportedLog:
    """Log of a table, in memory."""

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
        writer = begin_log(file, made.header, tuple(one.spec for one in made.series))
        rows = [zip(one.ticks.tolist(), repeat(one.spec.id), one.data, strict=False) for one in made.series]
        for tick, channel, message in merge(*rows, key=itemgetter(0)):
            writer.add(tick * TICK_NS, [(channel, message.tobytes())])
        writer.finish([])
    return made


def convert_table(table: Path, mapping: Path) -> ImportedLog:
    """Convert a table to a log in memory; RobotError if the table or the mapping is wrong."""
    file = parse_record(MappingFile, read_toml(mapping), mapping)
    topics = map_channels(mapping, file.channels)
    columns = [name for channels in topics.values() for one in channels for name in one.columns]
    clock = [file.time.column] if file.time.column else []
    log = open_log(table, [*columns, *clock], clock, file.csv)
    read = {topic: _read_rows(log, file.time, channels) for topic, channels in topics.items()}
    start_s = min(rows.time_s[0] for rows in read.values())
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is refused, what was stays
        series = tuple(
            _build_topic(number, topic, read[topic], channels, file.time.grid, start_s)
            for number, (topic, channels) in enumerate(topics.items(), 1)
        )
    params = read_params(mapping, file.params)
    about = {"table": str(table), "mapping": str(mapping)}
    about |= {"table_sha256": file_sha256(table), "mapping_sha256": file_sha256(mapping)}
    reference = stored_reference(file.reference, params) if file.reference else None
    header = {
        **versions_header(),
        **(start_header(params, Mode.DEPLOYED, reference) if reference else {}),
        **commands_header(()),
        **({SESSION: json.dumps(file.session.model_dump())} if file.session else {}),
        "cpu": UNKNOWN_CPU,
        "arm": file.arm,
        "seed": "unknown",
        "request": json.dumps({IMPORT: about}, sort_keys=True),
        "mjcf_sha256": "unknown",
    }
    return ImportedLog(series, header)


def _read_rows(log: LogFile, time: GridTime, channels: Iterable[MappedChannel]) -> TopicRows:
    """Read the rows of a topic; RobotError if a value is missing in one, or a time is not after the last."""
    columns = {name: log.numbers(name) for one in channels for name in one.columns}
    first, *_ = columns
    time_s = read_times(log, time.column) * UNITS[time.unit].factor if time.column else columns[first].time_s
    if time_s is None:
        raise RobotError(f"{log.path}: has no times of its own; name its time column in time.column")
    for name, one in columns.items():
        own_s = time_s if time.column or one.time_s is None else one.time_s
        if one.value.size != time_s.size or not np.array_equal(own_s, time_s):
            raise RobotError(f"{log.path}: column {name!r}: has other times than {first!r}")
    given = np.stack(
        [np.ones(time_s.size, bool) if one.is_present is None else one.is_present for one in columns.values()]
    )
    row = np.flatnonzero(given.any(axis=0))
    rows = TopicRows(log.path, row, time_s[row], {name: one.value[row] for name, one in columns.items()})
    if not row.size:
        raise RobotError(f"{log.path}: column {first!r}: no row has a value")
    for name, there in zip(columns, given[:, row], strict=True):
        if not there.all():
            raise rows.error_at(
                "has no value; a row needs all columns of a topic, or none", int(np.argmin(there)), name
            )
    late = np.flatnonzero(np.diff(rows.time_s) <= 0)
    if late.size:
        raise rows.error_at("its time is not after that of the row before", int(late[0]) + 1, time.column)
    return rows


def _build_topic(
    number: int, topic: str, rows: TopicRows, channels: Sequence[MappedChannel], grid: str, start_s: float
) -> TopicMessages:
    """Build the messages of a topic, which becomes the channel of this number; cycle 0 is at `start_s`."""
    layout, packet = layout_of(topic), PACKET_TOPICS[topic].packet
    cycles = (rows.time_s - start_s) * CYCLE_HZ
    ticks, below, fraction = _exact(rows, cycles) if grid == "exact" else _between(rows, cycles)
    data = np.zeros(ticks.size, layout.dtype)
    data.view(np.uint8).reshape(data.size, -1)[:, : len(ENCAPSULATION)] = list(ENCAPSULATION)
    if topic == SENSOR_TOPIC:
        data["cycle"] = ticks
    for one in channels:
        data[one.field.name] = _interpolate(_values(rows, one), below, fraction)
    spec = layout_spec(number, topic, packet.__name__, packet.__doc__, layout, is_truth=False)
    return TopicMessages(spec, ticks, data)


def _exact(rows: TopicRows, cycles: Array) -> tuple[Rows, Rows, Array]:
    """Return cycles that have one row each, (m,), the rows, and zeros; else RobotError."""
    ticks = np.rint(cycles)
    wrong = np.abs(cycles - ticks) > TOLERANCE_CYCLES
    wrong[1:] |= np.diff(ticks) != 1
    if wrong.any():
        row = int(np.argmax(wrong))
        raise rows.error_at(
            f"{cycles[row] - cycles[max(row - 1, 0)]:.6g} cycles of {CYCLE_HZ} Hz after the row before, "
            f'{cycles[row]:.6g} after the first; if the unit is right, write grid = "linear" under [time] '
            "to resample the rows",
            row,
        )
    return ticks.astype(np.int64), np.arange(ticks.size), np.zeros(ticks.size)


def _between(rows: TopicRows, cycles: Array) -> tuple[Rows, Rows, Array]:
    """Return the cycles within the rows, (m,), the row before each, and the way to the next row, 0 to 1."""
    wide = np.flatnonzero(np.diff(cycles) > MAX_INTERVAL_S * CYCLE_HZ + CYCLE_ROUNDING)
    if wide.size:
        k = int(wide[0])
        gap_s = (cycles[k + 1] - cycles[k]) / CYCLE_HZ
        raise rows.error_at(f"{gap_s:.6g} s after the row before; at most {MAX_INTERVAL_S:g} s", k + 1)
    last = int(np.floor(cycles[-1] + CYCLE_ROUNDING))
    ticks = np.arange(int(np.ceil(cycles[0] - CYCLE_ROUNDING)), last + 1)
    below = np.clip(np.searchsorted(cycles, ticks + CYCLE_ROUNDING, side="right") - 1, 0, None)
    width = cycles[np.minimum(below + 1, cycles.size - 1)] - cycles[below]
    fraction = np.divide(ticks - cycles[below], width, out=np.zeros(ticks.size), where=width > 0)
    fraction[np.abs(ticks - cycles[below]) < CYCLE_ROUNDING] = 0.0
    return ticks, below, fraction


def _interpolate(values: NDArray[Any], below: Rows, fraction: Array) -> NDArray[Any]:
    """Interpolate values of rows, (k, ...), to messages, (m, ...); flags keep that of the last row."""
    found = values[below]
    if values.dtype == np.bool_:
        return found
    inside = np.flatnonzero(fraction)
    share = fraction[inside].reshape(-1, *(1,) * (values.ndim - 1))
    # Not low + share * (high - low): the difference of two finite numbers may be infinite.
    between = (1 - share) * values[below[inside]] + share * values[below[inside] + 1]
    found[inside] = np.rint(between) if values.dtype.kind == "i" else between
    return found


def _values(rows: TopicRows, one: MappedChannel) -> NDArray[Any]:
    """Convert the columns of a channel, or its constant, to the type of the log, shape (n, *shape of it)."""
    kind, parts = np.dtype(one.field.kind), []
    given = [rows.values[name] for name in one.columns]
    for k, read in enumerate(given or [np.full(rows.row.size, value) for value in one.constant]):
        # a step that changes nothing is left out, so that every bit is kept
        values = read * one.factor[k] if one.factor[k] != 1.0 else read
        values = values + one.offset[k] if one.offset[k] != 0.0 else values
        is_bad, why = _misfits(one, read, values)
        if is_bad.any():
            row = int(np.argmax(is_bad))
            said = f"{read[row]:.17g} {why}"
            if not one.columns:
                raise RobotError(f"{one.where}.value: {said}")
            raise rows.error_at(f"{said}, for {one.name}", row, one.columns[k])
        parts.append(np.rint(values).astype(kind) if kind.kind == "i" else values.astype(kind))
    return np.stack(parts, axis=1).reshape(rows.row.size, *(one.field.shape or ()))


def _misfits(one: MappedChannel, read: Array, values: Array) -> tuple[NDArray[np.bool_], str]:
    """Return which values, (n,), a channel cannot hold, and why."""
    match one.field.kind:
        case "|b1":
            return (values != 0.0) & (values != 1.0), "is neither true nor false, 1 nor 0"
        case "<i8":
            is_broken = np.zeros(values.size, bool) if one.is_rounded else values != np.rint(values)
            return is_broken | ~(np.abs(values) <= MAX_EXACT_INT), "is no whole number that is exact"
    return np.isfinite(read) & ~np.isfinite(values), "is too large for its factor, offset and unit"


def import_document(log: Path, made: ImportedLog) -> dict[str, Any]:
    """Collect an import."""
    topics = [
        {"topic": one.spec.topic, "messages": one.ticks.size, "first_tick": one.ticks[0]}
        for one in made.series
    ]
    return {"log": log, "topics": topics}


def import_parts(log: Path, made: ImportedLog) -> list[str]:
    """Show an import: a line for each topic."""
    return [
        f"{one.spec.topic:<10}{pluralize(one.ticks.size, 'message')} from cycle {one.ticks[0]} on, in {log}"
        for one in made.series
    ]
