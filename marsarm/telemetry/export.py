"""Export of a log to Parquet or CSV, one table for each topic."""

import csv
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from io import TextIOWrapper
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from marsarm.common.fields import unit_of
from marsarm.telemetry.events import CommandEntry, EvrEntry
from marsarm.telemetry.format import COMMAND_TOPIC, EVR_TOPIC, TICK_NS, TRUTH_TEXT
from marsarm.telemetry.inspection import NoSuchChannel, index_text, severity_name
from marsarm.telemetry.read import Log
from simgap.common.errors import BadOutput
from simgap.common.files import atomic_write, check_distinct_files, check_new_path, check_output
from simgap.common.progress import Progress

ColumnValues = NDArray[np.generic] | Sequence[str]
TABLE_SUFFIXES: Final = (".parquet", ".csv")


@dataclass(frozen=True, slots=True, eq=False)
class TopicTable:
    """Topic as columns of one length: time_ns, tick, and each number of each field."""

    topic: str
    columns: Mapping[str, ColumnValues]
    units: Mapping[str, str]
    is_truth: bool


def index_suffixes(shape: tuple[int, ...]) -> list[str]:
    """Return the suffix of each column of a field of this shape, row by row: "[2]" or "[0,1]"."""
    return [index_text(index) for index in np.ndindex(*shape)]


def topic_table(log: Log, topic: str) -> TopicTable:
    """Convert a topic of a log to a table."""
    columns: dict[str, ColumnValues] = {"time_ns": log.time_ns[topic], "tick": log.time_ns[topic] // TICK_NS}
    units = {"time_ns": "ns"}
    if topic == EVR_TOPIC:
        columns |= _evr_columns(log.evrs)
    elif topic == COMMAND_TOPIC:
        columns |= _command_columns(log.commands)
    else:
        packets = log[topic]
        for field in packets.dtype.names or ():
            values, unit = packets[field], unit_of(field)
            numbers = values.reshape(len(values), prod(values.shape[1:]))
            for k, end in enumerate(index_suffixes(values.shape[1:])):
                # Some packets have a field `tick` of their own, and both columns are kept.
                name = f"{field}{end}" if field not in columns else f"packet.{field}{end}"
                columns[name] = np.ascontiguousarray(numbers[:, k])
                if unit is not None:
                    units[name] = unit
    return TopicTable(topic, columns, units, topic in log.truth)


def _evr_columns(evrs: Sequence[EvrEntry]) -> dict[str, ColumnValues]:
    return {
        "severity": [severity_name(evr.severity) for evr in evrs],
        "name": [evr.name for evr in evrs],
        "message": [evr.message for evr in evrs],
        "fields_json": [evr.fields_json for evr in evrs],
    }


def _command_columns(commands: Sequence[CommandEntry]) -> dict[str, ColumnValues]:
    return {
        "name": [command.name for command in commands],
        "fields_json": [command.fields_json for command in commands],
    }


def export(
    log: Log, out: Path, topics: Sequence[str], progress: Progress, kind: str = ".parquet"
) -> dict[str, Path]:
    """Write topics to one file, or to one file each in a folder; all files appear together at the end.

    Args:
        log: Log to export.
        out: File for one topic, or folder.
        topics: Topics to write; all if empty.
        progress: Called for each topic.
        kind: Suffix of the files in a folder.

    Returns:
        File of each topic.

    Raises:
        NoSuchChannel: the log has no such topic.
        BadOutput: a file cannot be written, or one file is given for several topics.
        BadRequest: a file is the log itself.
    """
    if not log.time_ns:
        raise NoSuchChannel(f"log {log.path} holds no message; there is nothing to export")
    chosen = _select_topics(log, topics)
    files = _output_files(out, chosen, kind)
    for topic, path in files.items():
        check_distinct_files({"LOG": log.path, f"out ({topic})": path})
    header = json.dumps(dict(log.header))
    is_new_folder = _make_folder(out)
    try:
        with ExitStack() as open_files:
            for k, (topic, path) in enumerate(files.items()):
                progress(k, len(files), topic)
                file = open_files.enter_context(atomic_write(path, "out"))
                write = write_csv if path.suffix == ".csv" else write_parquet
                write(topic_table(log, topic), header, file)
    except BaseException:
        if is_new_folder:
            out.rmdir()
        raise
    return files


def _make_folder(out: Path) -> bool:
    """Make the folder if it does not exist, and return whether it was made.

    Raises:
        BadOutput: the folder cannot be made.
    """
    if out.suffix in TABLE_SUFFIXES or os.path.isdir(out):
        return False
    try:
        out.mkdir()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise BadOutput(f"out {out}: this folder cannot be made ({why}); give another") from error
    return True


def _select_topics(log: Log, topics: Sequence[str]) -> list[str]:
    missing = [topic for topic in topics if topic not in log.time_ns]
    if missing:
        has = ", ".join(sorted(log.time_ns))
        raise NoSuchChannel(f"log {log.path} has no topic {missing[0]}; it has {has}")
    return list(dict.fromkeys(topics)) or sorted(log.time_ns)


def _output_files(out: Path, topics: Sequence[str], kind: str) -> dict[str, Path]:
    """Return the file of each topic, after all checks that are possible before writing."""
    if out.suffix in TABLE_SUFFIXES and not os.path.isdir(out):  # unlike Path.is_dir, never raises
        if kind == ".csv" != out.suffix:
            raise BadOutput(f"out {out}: with --csv its name must end in .csv, or be that of a folder")
        if len(topics) != 1:
            raise BadOutput(
                f"out {out}: one file holds one table, and {len(topics)} topics are selected; "
                f"name one with --topic, or give a folder"
            )
        return {topics[0]: check_output(out, TABLE_SUFFIXES, "out")}
    if not os.path.isdir(out) and (os.path.exists(out) or out.suffix):
        raise BadOutput(
            f"out {out}: must end in .parquet or .csv, or be a folder; the name of a new one has no dot"
        )
    check_new_path(out, "out")
    files = {topic: out / (topic.strip("/").replace("/", "_") + kind) for topic in topics}
    if os.path.isdir(out):
        for path in files.values():
            check_output(path, TABLE_SUFFIXES, "out")
    return files


def write_parquet(table: TopicTable, header: str, file: BinaryIO) -> None:
    """Write a Parquet table with the header of the log and the units as metadata; numbers keep every bit."""
    fields, arrays = [], []
    for name, column in table.columns.items():
        # pandas takes a NaN for a missing value; here it is a number.
        array = pa.array(column, from_pandas=False)
        unit = table.units.get(name)
        fields.append(pa.field(name, array.type, metadata=None if unit is None else {"unit": unit}))
        arrays.append(array)
    metadata = {"marsarm.header": header, "marsarm.topic": table.topic}
    if table.is_truth:
        metadata["marsarm.truth"] = TRUTH_TEXT
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata)), file)


def write_csv(table: TopicTable, header: str, file: BinaryIO) -> None:
    """Write a CSV table with one line of names; numbers read back exactly, and the header is not written."""
    text = TextIOWrapper(file, "utf-8", newline="")
    out = csv.writer(text, lineterminator="\n")
    out.writerow(table.columns)
    out.writerows(zip(*map(_csv_values, table.columns.values()), strict=True))
    text.flush()
    text.detach()


def _csv_values(column: ColumnValues) -> Sequence[Any]:
    """Convert flags to 0 and 1, and numbers to Python numbers, whose text reads back exactly."""
    if isinstance(column, np.ndarray):
        values: list[Any] = (column.astype(np.int8) if column.dtype.kind == "b" else column).tolist()
        return values
    return column
