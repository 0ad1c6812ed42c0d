"""The import job: read table and mapping, check everything, write the log, say what is in it."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Command
from ground.common.files import BadOutput, check_output, written_whole
from ground.common.progress import Progress
from ground.common.requests import BadRequest, check_apart
from ground.telemetry.format import TICK_NS
from ground.telemetry.header import SESSION, asked, begins_with, made_by
from ground.telemetry.imports.errors import BadImport
from ground.telemetry.imports.files import MOST_TABLE_BYTES, file_bytes
from ground.telemetry.imports.mapping import Mapping, Start
from ground.telemetry.imports.mapping_file import MOST_MAPPING_BYTES, mapping_from
from ground.telemetry.imports.packets import Lacking, lacking, series_of
from ground.telemetry.imports.table import MOST_CELLS, read_table
from ground.telemetry.imports.times import in_order
from ground.telemetry.table_log import Series, write_table_log

SENSORS: Final = "/sensors"
UNKNOWN_CPU: Final = "[]"
"""Nobody knows what the table's numbers were computed on."""


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """What is asked."""

    table: Path
    mapping: Path
    log: Path


@dataclass(frozen=True, slots=True)
class TopicReport:
    """What a topic of the log has; ticks are those of its first and last message."""

    topic: str
    messages: int
    first_tick: int
    last_tick: int
    missing_ticks: int
    """Between the two."""


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What came of it."""

    request: ImportRequest
    rows: int
    rows_moved: int
    """In how many places the file was not in order of time."""
    topics: tuple[TopicReport, ...]
    commands: int
    lacking: tuple[Lacking, ...]
    replayable: bool


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """A log in memory."""

    mapping: Mapping
    rows: int
    rows_moved: int
    series: tuple[Series, ...]
    header: dict[str, str]

    @property
    def commands(self) -> tuple[tuple[int, Command], ...] | None:
        """With their ticks; None where the mapping has no start, and so no word about commands."""
        start = self.mapping.start
        return None if start is None else tuple((one.tick, one.command) for one in start.commands)


def import_table(request: ImportRequest, progress: Progress) -> ImportReport:
    """Carry out an import.

    Raises:
        BadRequest: the table, the mapping or the path of the log is wrong; nothing was written.
    """
    check_apart({"table": request.table, "mapping": request.mapping, "log": request.log})
    try:
        check_output(request.log, (".mcap",), "log")
        progress(0, 3, "reading the mapping")
        text = file_bytes(request.mapping, MOST_MAPPING_BYTES)
        progress(1, 3, "reading the table")
        made = imported(
            file_bytes(request.table, MOST_TABLE_BYTES), str(request.table), text, str(request.mapping)
        )
        progress(2, 3, "writing the log")
        with written_whole(request.log, "log") as file:
            write_table_log(file, made.header, made.series, made.commands)
    except (BadImport, BadOutput) as error:
        raise BadRequest(str(error)) from error
    except MemoryError as error:
        raise BadRequest(f"{request.table}: is too large for the memory; give it in parts") from error
    return _report(request, made)


def imported(
    table: bytes, table_file: str, mapping: bytes, mapping_file: str, cells: int = MOST_CELLS
) -> Imported:
    """The log that a table and a mapping make; the names are how messages call them.

    Raises:
        BadImport: one of them is wrong; of the mapping, every problem at once.
    """
    try:
        text = mapping.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadImport(
            [f"{mapping_file}: is no text in UTF-8 ({error.reason}, byte {error.start})"]
        ) from error
    said = mapping_from(text, mapping_file, Path(mapping_file).parent)
    times = () if said.time.column is None else (said.time.column,)
    names = dict.fromkeys((*times, *(name for channel in said.channels for name in channel.columns)))
    if not names:
        raise BadImport(
            [f"{mapping_file}: channel: none has columns; there is nothing to take from the table"]
        )
    read = in_order(read_table(table, table_file, tuple(names), said.csv, cells), said.time)
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is looked for and refused
        series = series_of(read, said, cells)
    if said.start is not None:
        _check_replayable(mapping_file, said, said.start, series)
    about = {
        "table": table_file,
        "table_sha256": hashlib.sha256(table).hexdigest(),
        "mapping": mapping_file,
        "mapping_sha256": hashlib.sha256(mapping).hexdigest(),
    }
    return Imported(said, read.rows, read.rows_moved, series, _header(said, about))


def _check_replayable(file: str, mapping: Mapping, start: Start, series: tuple[Series, ...]) -> None:
    """Refuse a start without readings in every cycle, and commands in a cycle that is not there."""
    sensors = next((one for one in series if one.topic == SENSORS), None)
    if sensors is None:
        said = next((one.fields for one in lacking(mapping) if one.topic == SENSORS), ())
        what = f"it lacks {', '.join(said)}" if said else "there is none"
        raise BadImport(
            [f"{file}: start: replay needs all of {SENSORS}, {what}; map it, or leave out [start]"]
        )
    gaps = np.flatnonzero(np.diff(sensors.ticks) != 1)
    if sensors.ticks[0] != 0 or gaps.size:
        where = (
            f"tick {sensors.ticks[0]} comes first"
            if sensors.ticks[0] != 0
            else (f"tick {sensors.ticks[gaps[0]] + 1} is missing")
        )
        raise BadImport(
            [f"{file}: start: replay needs {SENSORS} in every tick from 0 on, {where}; leave out [start]"]
        )
    last = int(sensors.ticks[-1])
    never = [one for one in start.commands if one.tick > last]
    if never:
        raise BadImport(
            f"{file}:{one.line}: command: at_s is {one.tick / CYCLE_HZ:.15g}, the table ends at "
            f"{last / CYCLE_HZ:.15g}; it would never be given: leave it out"
            for one in never
        )


def _header(mapping: Mapping, about: dict[str, str]) -> dict[str, str]:
    start = mapping.start
    begins = {} if start is None else begins_with(start.params, start.mode, start.reference)
    commands = [] if start is None else [one.command for one in start.commands]
    done = {} if mapping.session is None else {SESSION: json.dumps(asdict(mapping.session))}
    return {
        **made_by(),
        **begins,
        **asked(commands),
        **done,
        "cpu": UNKNOWN_CPU,
        "arm": mapping.arm,
        "seed": "unknown",
        "request": json.dumps({"import": about}, sort_keys=True),
        "mjcf_sha256": "unknown",
    }


def _report(request: ImportRequest, made: Imported) -> ImportReport:
    topics = tuple(
        TopicReport(
            topic=one.topic,
            messages=one.ticks.size,
            first_tick=int(one.ticks[0]),
            last_tick=int(one.ticks[-1]),
            missing_ticks=int(one.ticks[-1] - one.ticks[0] + 1) - one.ticks.size,
        )
        for one in made.series
    )
    start = made.mapping.start
    commands = 0 if start is None else len(start.commands)
    return ImportReport(
        request, made.rows, made.rows_moved, topics, commands, lacking(made.mapping), start is not None
    )


def duration_s(topic: TopicReport) -> float:
    """From the first message of a topic to the last."""
    return (topic.last_tick - topic.first_tick) * TICK_NS * 1e-9
