"""Reports of the verbs of `marsarm log`, as documents, tables and sentences; and the export of topics."""

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv

from marsarm.common.fields import unit_of
from marsarm.telemetry.format import (
    EVR_TOPIC,
    FORMAT,
    TICK_NS,
    TRUTH_TEXT,
    LostMessages,
    span_text,
    trailing_bytes_text,
)
from marsarm.telemetry.inspection import ChannelSeries, index_text, severity_name
from marsarm.telemetry.read import Log
from marsarm.telemetry.recover import RecoveryReport
from marsarm.telemetry.topics import ENTRIES
from simgap.common.console import pluralize
from simgap.common.errors import BadOutput, BadRequest
from simgap.common.files import atomic_write, check_distinct_files, check_new_path, check_output
from simgap.common.progress import Progress
from simgap.common.report import ReportTable

OMITTED_KEYS: Final = ("channels", "commands", "params")
"""Keys of the header that are too long for people."""
JSON_KEYS: Final = ("boot", "cpu", "effects", "request", "session", "world")
"""Keys of the header whose values are JSON."""


def info_document(log: Log) -> dict[str, Any]:
    """Collect a log, without the keys of the header in OMITTED_KEYS; cycles are those with a message."""
    times = [time_ns for time_ns in log.time_ns.values() if len(time_ns)]
    cycles = np.unique(np.concatenate(times)).tolist() if times else []
    duration_s = (cycles[-1] - cycles[0] + TICK_NS) / 1e9 if cycles else 0.0
    counts = Counter(evr.severity for evr in log.evrs)
    return {
        "log": log.path,
        "format": FORMAT,
        "closed": log.end == "closed",
        "end": log.end,
        "interrupted_by": log.interrupted_by or None,
        "trailing_bytes": log.trailing_bytes,
        "header": {
            name: _parse_header_value(name, text)
            for name, text in log.header.items()
            if name not in OMITTED_KEYS
        },
        "first_s": cycles[0] / 1e9 if cycles else None,
        "duration_s": duration_s,
        "cycles": len(cycles),
        "topics": [
            {
                "topic": topic,
                "messages": len(time_ns),
                "rate_hz": len(time_ns) / duration_s,
                "truth": topic in log.truth,
            }
            for topic, time_ns in sorted(log.time_ns.items())
        ],
        "evrs": {severity_name(severity): counts[severity] for severity in sorted(counts, reverse=True)},
        "commands": [command.name for command in log.commands],
        "lost": _lost_document(log.lost),
    }


def _parse_header_value(name: str, text: str) -> Any:
    try:
        return json.loads(text) if name in JSON_KEYS else text
    except ValueError:
        return text


def _say_value(value: Any) -> str:
    """Return a value of the header for people; digests and long lists are cut."""
    if isinstance(value, dict):
        return "; ".join(f"{key} {_say_value(one)}" for key, one in value.items())
    if isinstance(value, list):
        said = [_say_value(one) for one in value]
        return ", ".join(said) or "none" if len(said) < 7 else f"{said[0]} and {len(said) - 1} more"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = str(value)
    return text[:12] if len(text) in (40, 64) and set(text) <= set("0123456789abcdef") else text


def _lost_document(lost: Sequence[LostMessages]) -> list[dict[str, Any]]:
    """Collect losses; times in seconds of log time, None for unknown."""
    return [
        {
            "topic": one.topic,
            "messages": one.count,
            "after_s": None if one.after_ns is None else one.after_ns / 1e9,
            "before_s": None if one.before_ns is None else one.before_ns / 1e9,
        }
        for one in lost
    ]


def info_parts(log: Log) -> list[str | ReportTable]:
    """Show a log: header, duration, topics and event reports."""
    info = info_document(log)
    state = log.end_note or log.end
    if log.trailing_bytes:
        state += f"; {trailing_bytes_text(log.trailing_bytes)}"
    duration = "nothing was recorded"
    if info["first_s"] is not None:
        duration = f"{info['duration_s']:.3f} s from {info['first_s']:.3f} s on, {info['cycles']} cycles"
    about = {name: _say_value(info["header"][name]) for name in sorted(info["header"])}
    about |= {"format": FORMAT, "duration": duration, "end": state}
    rows = [
        (one["topic"], str(one["messages"]), f"{one['rate_hz']:.2f}", "truth" if one["truth"] else "")
        for one in info["topics"]
    ]
    evrs = ", ".join(f"{count} {name}" for name, count in info["evrs"].items())
    recovered: list[str | ReportTable] = []
    if log.lost:
        recovered = ["This log was recovered from a damaged one.", _lost_table(log.lost)]
    return [
        *(f"{name:<16}  {text}" for name, text in about.items()),
        *([ReportTable(("topic", "messages", "rate Hz", ""), rows)] if rows else []),
        f"EVRs: {evrs or 'none'}",
        *recovered,
    ]


def channels_document(log: Log, channels: Sequence[ChannelSeries]) -> dict[str, Any]:
    """Collect channels of a log, with their finite ranges and the number of other values."""
    return {"log": log.path, "channels": [_channel_document(one) for one in channels]}


def _channel_document(one: ChannelSeries) -> dict[str, Any]:
    values = one.values.astype(np.int8) if one.values.dtype.kind == "b" else one.values
    finite = values[np.isfinite(values)]
    return {
        "channel": one.name,
        "type": one.type_name,
        "unit": one.unit,
        "truth": one.is_truth,
        "messages": len(one.time_ns),
        "min": finite.min() if finite.size else None,
        "max": finite.max() if finite.size else None,
        "not_finite": values.size - finite.size,
    }


def channels_parts(log: Log, channels: Sequence[ChannelSeries]) -> list[ReportTable]:
    """Show channels of a log, one in each line."""
    rows = [
        (
            one["channel"],
            one["type"],
            one["unit"] or "",
            str(one["messages"]),
            _number_text(one["min"]),
            _number_text(one["max"]),
            str(one["not_finite"] or ""),
        )
        for one in channels_document(log, channels)["channels"]
    ]
    head = ("channel", "type", "unit", "count", "min", "max", "NaN, inf")
    return [ReportTable(head, rows, is_whole=True)]


def _number_text(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, np.floating) else str(value)


def recovery_document(bad: Path, good: Path, recovered: RecoveryReport) -> dict[str, Any]:
    """Collect a recovery."""
    return {
        "bad": bad,
        "good": good,
        "header_lost": recovered.header_lost,
        "saved": recovered.saved,
        "lost": _lost_document(recovered.lost),
        "notes": recovered.notes,
    }


def recovery_parts(good: Path, recovered: RecoveryReport) -> list[str | ReportTable]:
    """Show the saved and the lost messages."""
    header = ["The header is lost: versions, parameters and commands of the run."] * recovered.header_lost
    return [
        f"{sum(recovered.saved.values())} messages saved in {good}",
        *header,
        *(f"{note[0].upper()}{note[1:]}." for note in recovered.notes),
        _lost_table(recovered.lost) if recovered.lost else "Nothing was lost.",
    ]


def _lost_table(lost: Sequence[LostMessages]) -> ReportTable:
    rows = [
        (
            one.topic or "all",
            "unknown" if one.count is None else str(one.count),
            span_text(one.after_ns, one.before_ns),
        )
        for one in lost
    ]
    return ReportTable(("topic", "messages", "log time"), rows, "lost")


def export_document(log: Log, files: Mapping[str, Path]) -> dict[str, Any]:
    """Collect the files that were written."""
    rows = [{"topic": topic, "file": path, "rows": len(log.time_ns[topic])} for topic, path in files.items()]
    return {"log": log.path, "files": rows}


def export_parts(log: Log, files: Mapping[str, Path]) -> list[str]:
    """Show the files that were written."""
    return [
        f"{topic:<16} {pluralize(len(log.time_ns[topic]), 'row')} in {path}" for topic, path in files.items()
    ]


TABLE_SUFFIXES: Final = (".parquet", ".csv")


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
                columns[name] = np.ascontiguousarray(numbers[:, k])
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


def export(
    log: Log, out: Path, topics: Sequence[str], progress: Progress, kind: str = ".parquet"
) -> dict[str, Path]:
    """Write topics to one file, or to one file each in a folder; all files appear together at the end.

    Args:
        out: File for one topic, or folder.
        topics: Topics to write; all if empty.
        kind: Suffix of the files in a folder.

    Returns:
        File of each topic.

    Raises:
        BadRequest: the log has no such topic, or a file is the log itself.
        BadOutput: a file cannot be written, or one file is given for several topics.
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
                (write_csv if path.suffix == ".csv" else pq.write_table)(topic_table(log, topic), file)
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
        raise BadRequest(f"log {log.path} has no topic {missing[0]}; it has {has}")
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


def write_csv(table: pa.Table, file: BinaryIO) -> None:
    """Write a CSV table with one line of names; numbers read back exactly, flags are 0 and 1."""
    flags = [pa.uint8() if pa.types.is_boolean(one.type) else one.type for one in table.schema]
    csv.write_csv(table.cast(pa.schema(zip(table.column_names, flags, strict=True))), file)
