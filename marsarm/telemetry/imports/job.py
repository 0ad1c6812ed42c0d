"""Import of a table: request, conversion to a log, and the report as table and JSON document."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Command
from marsarm.telemetry.format import SENSOR_TOPIC, TICK_NS
from marsarm.telemetry.header import SESSION, commands_header, start_header, versions_header
from marsarm.telemetry.imports.files import MAX_TABLE_BYTES, BadImport, read_file
from marsarm.telemetry.imports.log_file import TopicMessages, write_table_log
from marsarm.telemetry.imports.mapping import FlightStart, TableMapping
from marsarm.telemetry.imports.mapping_file import MAX_MAPPING_BYTES, parse_mapping
from marsarm.telemetry.imports.packets import IncompleteTopic, build_topics, incomplete_topics
from marsarm.telemetry.imports.table import MAX_CELLS, read_table
from marsarm.telemetry.imports.times import sort_by_time
from simgap.common.console import plain_console, pluralize
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write, check_distinct_files, check_output
from simgap.common.progress import Progress
from simgap.common.toml import decode_text, key_path

UNKNOWN_CPU: Final = "[]"
"""Value of `cpu` in the header: the processor that computed the table is unknown."""


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """Request of an import: the table, its mapping and the new log."""

    table: Path
    mapping: Path
    log: Path


@dataclass(frozen=True, slots=True)
class TopicReport:
    """Summary of a topic: its messages, and the ticks of the first and the last."""

    topic: str
    messages: int
    first_tick: int
    last_tick: int
    missing_ticks: int
    """Ticks without a message between the first and the last."""


@dataclass(frozen=True, slots=True)
class ImportReport:
    """Result of an import."""

    request: ImportRequest
    rows: int
    rows_moved: int
    """Places where the file was not in order of time."""
    topics: tuple[TopicReport, ...]
    commands: int
    incomplete: tuple[IncompleteTopic, ...]
    replayable: bool


@dataclass(frozen=True, slots=True, eq=False)
class ImportedLog:
    """Converted log in memory."""

    mapping: TableMapping
    rows: int
    rows_moved: int
    series: tuple[TopicMessages, ...]
    header: dict[str, str]

    @property
    def commands(self) -> tuple[tuple[int, Command], ...] | None:
        """Commands with their ticks; None if the mapping has no [start], so that commands are unknown."""
        start = self.mapping.start
        return None if start is None else tuple((one.tick, one.command) for one in start.commands)


def import_table(request: ImportRequest, progress: Progress) -> ImportReport:
    """Convert a table to a log.

    Raises:
        BadRequest: the table, the mapping or the path of the log is wrong; nothing was written.
    """
    check_distinct_files({"table": request.table, "mapping": request.mapping, "OUT": request.log})
    try:
        check_output(request.log, (".mcap",), "OUT")
        progress(0, 3, "reading the mapping")
        text = read_file(request.mapping, MAX_MAPPING_BYTES)
        progress(1, 3, "reading the table")
        converted = convert_table(
            read_file(request.table, MAX_TABLE_BYTES), str(request.table), text, str(request.mapping)
        )
        progress(2, 3, "writing the log")
        with atomic_write(request.log, "OUT") as file:
            write_table_log(file, converted.header, converted.series, converted.commands)
    except MemoryError as error:
        raise BadRequest(f"{request.table}: is too large for the memory; give it in parts") from error
    return _report(request, converted)


def convert_table(
    table: bytes, table_file: str, mapping: bytes, mapping_file: str, cells: int = MAX_CELLS
) -> ImportedLog:
    """Convert the content of a table to a log in memory.

    Args:
        table: Content of the table.
        table_file: Name of the table, for messages.
        mapping: Content of the mapping.
        mapping_file: Name of the mapping, for messages; paths in the mapping start from its folder.
        cells: Limit of the numbers in the table.

    Raises:
        BadImport: the table or the mapping is wrong; all problems of a mapping are reported together.
    """
    try:
        text = decode_text(mapping, mapping_file)
    except RobotError as error:
        raise BadImport([str(error)]) from error
    parsed = parse_mapping(text, mapping_file, Path(mapping_file).parent)
    times = () if parsed.time.column is None else (parsed.time.column,)
    names = dict.fromkeys((*times, *(name for channel in parsed.channels for name in channel.columns)))
    if not names:
        raise BadImport(
            [f"{mapping_file}: channel: none has columns; there is nothing to take from the table"]
        )
    rows = sort_by_time(read_table(table, table_file, tuple(names), parsed.csv, cells), parsed.time)
    with np.errstate(over="ignore", invalid="ignore"):  # a value that becomes infinite is refused later
        series = build_topics(rows, parsed, cells)
    if parsed.start is not None:
        _check_replayable(mapping_file, parsed, parsed.start, series)
    about = {
        "table": table_file,
        "table_sha256": hashlib.sha256(table).hexdigest(),
        "mapping": mapping_file,
        "mapping_sha256": hashlib.sha256(mapping).hexdigest(),
    }
    return ImportedLog(parsed, rows.rows, rows.rows_moved, series, _import_header(parsed, about))


def _check_replayable(
    file: str, mapping: TableMapping, start: FlightStart, series: tuple[TopicMessages, ...]
) -> None:
    """Refuse [start] without sensors in every cycle, and commands after the last cycle."""
    sensors = next((one for one in series if one.topic == SENSOR_TOPIC), None)
    if sensors is None:
        lacking = next((one.fields for one in incomplete_topics(mapping) if one.topic == SENSOR_TOPIC), ())
        what = f"it lacks {', '.join(lacking)}" if lacking else "there is none"
        raise BadImport(
            [f"{file}: start: replay needs all of {SENSOR_TOPIC}, {what}; map it, or leave out [start]"]
        )
    breaks = np.flatnonzero(np.diff(sensors.ticks) != 1)
    if sensors.ticks[0] != 0 or breaks.size:
        where = (
            f"tick {sensors.ticks[0]} comes first"
            if sensors.ticks[0] != 0
            else (f"tick {sensors.ticks[breaks[0]] + 1} is missing")
        )
        raise BadImport(
            [
                f"{file}: start: replay needs {SENSOR_TOPIC} in every tick from 0 on, {where}; "
                "leave out [start]"
            ]
        )
    last = int(sensors.ticks[-1])
    late = [one for one in start.commands if one.tick > last]
    if late:
        raise BadImport(
            f"{file}: {key_path((*one.place, 'at_s'))}: is {one.tick / CYCLE_HZ:.15g}, the table ends at "
            f"{last / CYCLE_HZ:.15g}; it would never be given: leave it out"
            for one in late
        )


def _import_header(mapping: TableMapping, about: dict[str, str]) -> dict[str, str]:
    start = mapping.start
    conditions = {} if start is None else start_header(start.params, start.mode, start.reference)
    commands = [] if start is None else [one.command for one in start.commands]
    session = {} if mapping.session is None else {SESSION: json.dumps(asdict(mapping.session))}
    return {
        **versions_header(),
        **conditions,
        **commands_header(commands),
        **session,
        "cpu": UNKNOWN_CPU,
        "arm": mapping.arm,
        "seed": "unknown",
        "request": json.dumps({"import": about}, sort_keys=True),
        "mjcf_sha256": "unknown",
    }


def _report(request: ImportRequest, converted: ImportedLog) -> ImportReport:
    topics = tuple(
        TopicReport(
            topic=one.topic,
            messages=one.ticks.size,
            first_tick=int(one.ticks[0]),
            last_tick=int(one.ticks[-1]),
            missing_ticks=int(one.ticks[-1] - one.ticks[0] + 1) - one.ticks.size,
        )
        for one in converted.series
    )
    start = converted.mapping.start
    commands = 0 if start is None else len(start.commands)
    return ImportReport(
        request,
        converted.rows,
        converted.rows_moved,
        topics,
        commands,
        incomplete_topics(converted.mapping),
        start is not None,
    )


def duration_s(topic: TopicReport) -> float:
    """Return the time from the first message of a topic to the last."""
    return (topic.last_tick - topic.first_tick) * TICK_NS * 1e-9


def import_json(report: ImportReport) -> dict[str, Any]:
    """Return an import as a JSON document."""
    return {
        "log": str(report.request.log),
        "rows": report.rows,
        "rows_moved": report.rows_moved,
        "topics": [{**asdict(topic), "duration_s": duration_s(topic)} for topic in report.topics],
        "commands": report.commands,
        "incomplete": [asdict(one) for one in report.incomplete],
        "replayable": report.replayable,
    }


def import_tables(report: ImportReport) -> None:
    """Print an import: a row for each topic, and the missing fields of incomplete topics."""
    console = plain_console()
    table = Table(title=f"{report.request.log}: {pluralize(report.rows, 'row')}", title_justify="left")
    for name in ("topic", "messages", "first tick", "last tick", "ticks without"):
        table.add_column(name, justify="left" if name == "topic" else "right")
    for topic in report.topics:
        numbers = (topic.messages, topic.first_tick, topic.last_tick, topic.missing_ticks)
        table.add_row(topic.topic, *map(str, numbers))
    console.print(table)
    if report.rows_moved:
        console.print(
            f"sorted    in {pluralize(report.rows_moved, 'place')} the file was not in order of time"
        )
    for one in report.incomplete:
        lacks = ", ".join(one.fields)
        console.print(f"{one.topic} is incomplete, so it is kept as {one.kept_as}; it lacks {lacks}")
    if report.replayable:
        console.print(
            f"replay    {pluralize(report.commands, 'command')}; `marsarm replay {report.request.log}`"
        )
    else:
        console.print("replay    no: the mapping does not say what flight software began with")
