"""Export of a log to Parquet or CSV, one table for each topic."""

import json
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv

from fsw.dictionary.enums import Mode
from marsarm.telemetry.format import EVR_TOPIC, TICK_NS, TRUTH_TEXT
from marsarm.telemetry.inspection import index_text, severity_name
from marsarm.telemetry.read import Log
from marsarm.telemetry.schema import unit_of
from marsarm.telemetry.topics import ENTRIES
from simgap.common.errors import BadOutput, BadRequest
from simgap.common.files import atomic_write, check_distinct_files, check_new_path, check_output
from simgap.common.progress import Progress


def index_suffixes(shape: tuple[int, ...]) -> list[str]:
    """Return the suffix of each column of a field of this shape, row by row: "[2]" or "[0,1]"."""
    return [index_text(index) for index in np.ndindex(*shape)]


def topic_table(log: Log, topic: str) -> pa.Table:
    """Convert a topic of a log to a table: time_ns, tick, and each number of each field.

    Units and the header of the log are metadata.
    """
    columns: dict[str, Any] = {"time_ns": log.time_ns[topic], "tick": log.time_ns[topic] // TICK_NS}
    units: dict[str, str | None] = {"time_ns": "ns"}
    if topic in ENTRIES:
        entries: Sequence[Any] = log.evrs if topic == EVR_TOPIC else log.commands
        names = [field.name for field in fields(ENTRIES[topic]) if field.name != "tick"]
        columns |= {name: [getattr(one, name) for one in entries] for name in names}
        if "severity" in columns:
            columns["severity"] = [severity_name(one) for one in columns["severity"]]
    else:
        packets = log[topic]
        for field in packets.dtype.names or ():
            values = packets[field]
            numbers = values.reshape(len(values), prod(values.shape[1:]))
            for k, end in enumerate(index_suffixes(values.shape[1:])):
                # Some packets have a field `tick` of their own, and both columns are kept.
                name = f"{field}{end}" if field not in columns else f"packet.{field}{end}"
                column = np.ascontiguousarray(numbers[:, k])
                columns[name] = _mode_names(log, topic, column.tolist()) if field == "mode" else column
                units[name] = unit_of(field)
    # pandas takes a NaN for a missing value; here it is a number.
    arrays = [pa.array(column, from_pandas=False) for column in columns.values()]
    metadata = {"marsarm.header": json.dumps(dict(log.header)), "marsarm.topic": topic}
    if topic in log.truth:
        metadata["marsarm.truth"] = TRUTH_TEXT
    schema = [
        pa.field(name, array.type, metadata={"unit": unit} if (unit := units.get(name)) else None)
        for name, array in zip(columns, arrays, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema(schema, metadata))


def _mode_names(log: Log, topic: str, modes: Sequence[int]) -> list[str]:
    """Return the name of each mode; BadRequest if one is not known."""
    names = {mode.value: mode.name for mode in Mode}
    unknown = [mode for mode in modes if mode not in names]
    if unknown:
        known = ", ".join(f"{value} {name}" for value, name in names.items())
        raise BadRequest(
            f"log {log.path}: {topic}.mode: {unknown[0]} is no mode; there are {known}; export it with the "
            "marsarm that wrote it, or other topics with --topic"
        )
    return [names[mode] for mode in modes]


def export(
    log: Log, out: Path, topics: Sequence[str], progress: Progress, kind: str = ".parquet"
) -> dict[str, Path]:
    """Write topics to one file each in a folder; all files appear together at the end.

    Args:
        topics: Topics to write; all if empty.
        kind: Suffix of the files.

    Raises:
        BadRequest: the log has no such topic, a mode is not known, or a file is the log itself.
        BadOutput: a file cannot be written.
    """
    if not log.time_ns:
        raise BadRequest(f"log {log.path} holds no message; there is nothing to export")
    chosen = _select_topics(log, topics)
    files = _output_files(out, chosen, kind)
    for topic, path in files.items():
        check_distinct_files({"LOG": log.path, f"out ({topic})": path})
    is_new_folder = _make_folder(out)
    try:
        with ExitStack() as open_files:
            for k, (topic, path) in enumerate(files.items()):
                progress(k, len(files), topic)
                file = open_files.enter_context(atomic_write(path, "out"))
                (write_csv if kind == ".csv" else pq.write_table)(topic_table(log, topic), file)
    except BaseException:
        if is_new_folder:
            out.rmdir()
        raise
    return files


def _make_folder(out: Path) -> bool:
    """Make the folder if it does not exist, BadOutput if that fails, and return whether it was made."""
    if os.path.isdir(out):
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
        raise BadRequest(f"log {log.path} has no topic {missing[0]}; it has {has}")
    return list(dict.fromkeys(topics)) or sorted(log.time_ns)


def _output_files(out: Path, topics: Sequence[str], kind: str) -> dict[str, Path]:
    """Return the file of each topic, after all checks that are possible before writing."""
    if os.path.exists(out) and not os.path.isdir(out):
        raise BadOutput(f"out {out}: is a file; give a folder, new or not")
    if out.suffix in (".csv", ".parquet") and not os.path.isdir(out):
        raise BadOutput(f"out {out}: is no name of a folder; give one, such as {out.stem}; --csv writes CSV")
    check_new_path(out, "out")
    files = {topic: out / (topic.strip("/").replace("/", "_") + kind) for topic in topics}
    if os.path.isdir(out):
        for path in files.values():
            check_output(path, (kind,), "out")
    return files


def write_csv(table: pa.Table, file: BinaryIO) -> None:
    """Write a CSV table with one line of names; numbers read back exactly, flags are 0 and 1."""
    flags = [pa.uint8() if pa.types.is_boolean(one.type) else one.type for one in table.schema]
    csv.write_csv(table.cast(pa.schema(zip(table.column_names, flags, strict=True))), file)
