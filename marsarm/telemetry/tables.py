"""Output of the verbs of `marsarm log`: JSON documents, and tables and sentences for people."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from marsarm.telemetry.errors import LostMessages, span_text, trailing_bytes_text
from marsarm.telemetry.format import FORMAT
from marsarm.telemetry.inspection import ChannelSeries, range_of, summarize_log
from marsarm.telemetry.read import Log
from marsarm.telemetry.recover import RecoveryReport
from simgap.common.console import pluralize
from simgap.common.report import ReportTable, print_parts

OMITTED_KEYS: Final = ("channels", "commands", "params")
"""Keys of the header that are too long for people."""
JSON_KEYS: Final = ("boot", "cpu", "request")
"""Keys of the header whose values are JSON."""


def info_json(log: Log) -> dict[str, Any]:
    """Return a log as a JSON document, without the keys of the header in OMITTED_KEYS."""
    info = summarize_log(log)
    return {
        "log": str(log.path),
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
        "first_s": info.first_s,
        "duration_s": info.duration_s,
        "cycles": info.cycles,
        "topics": [
            {"topic": one.name, "messages": one.messages, "rate_hz": one.rate_hz, "truth": one.is_truth}
            for one in info.topics
        ],
        "evrs": info.evrs,
        "commands": [command.name for command in log.commands],
        "lost": _lost_json(log.lost),
    }


def _parse_header_value(name: str, text: str) -> Any:
    try:
        return json.loads(text) if name in JSON_KEYS else text
    except ValueError:
        return text


def _lost_json(lost: Sequence[LostMessages]) -> list[dict[str, Any]]:
    """Return losses as a JSON document; times in seconds of log time, null for unknown."""
    return [
        {
            "topic": one.topic,
            "messages": one.count,
            "after_s": None if one.after_ns is None else one.after_ns / 1e9,
            "before_s": None if one.before_ns is None else one.before_ns / 1e9,
        }
        for one in lost
    ]


def info_table(log: Log) -> None:
    """Print a log: header, duration, topics and event reports."""
    info = summarize_log(log)
    state = log.end_note or log.end
    if log.trailing_bytes:
        state += f"; {trailing_bytes_text(log.trailing_bytes)}"
    duration = "nothing was recorded"
    if info.first_s is not None:
        duration = f"{info.duration_s:.3f} s from {info.first_s:.3f} s on, {info.cycles} cycles"
    about = {name: log.header[name] for name in sorted(log.header) if name not in OMITTED_KEYS}
    about |= {"format": FORMAT, "duration": duration, "end": state}
    rows = [
        (one.name, str(one.messages), f"{one.rate_hz:.2f}", "truth" if one.is_truth else "")
        for one in info.topics
    ]
    evrs = ", ".join(f"{count} {name}" for name, count in info.evrs.items())
    recovered: list[str | ReportTable] = ["This log was recovered from a damaged one.", _lost_table(log.lost)]
    topics = [ReportTable(("topic", "messages", "rate Hz", ""), rows)] if rows else []
    print_parts(
        [
            *(f"{name:<16}  {text}" for name, text in about.items()),
            *topics,
            f"EVRs: {evrs or 'none'}",
            *recovered,
        ]
    )


def channels_json(log: Log, channels: Sequence[ChannelSeries]) -> dict[str, Any]:
    """Return the channels of a log as a JSON document."""
    found = []
    for one in channels:
        values = range_of(one)
        found.append(
            {
                "channel": one.name,
                "type": one.type_name,
                "unit": one.unit,
                "truth": one.is_truth,
                "messages": len(one.time_ns),
                "min": values.low,
                "max": values.high,
                "not_finite": values.not_finite,
            }
        )
    return {"log": str(log.path), "channels": found}


def channels_table(log: Log, channels: Sequence[ChannelSeries]) -> None:
    """Print the channels of a log, one in each line."""
    rows = [
        (
            one["channel"],
            one["type"],
            one["unit"] or "",
            str(one["messages"]),
            _number(one["min"]),
            _number(one["max"]),
            str(one["not_finite"] or ""),
        )
        for one in channels_json(log, channels)["channels"]
    ]
    head = ("channel", "type", "unit", "count", "min", "max", "NaN, inf")
    print_parts([ReportTable(head, rows, is_whole=True)])


def _number(value: float | int | None) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def recovery_json(bad: Path, good: Path, recovered: RecoveryReport) -> dict[str, Any]:
    """Return a recovery as a JSON document."""
    return {
        "bad": str(bad),
        "good": str(good),
        "header_lost": recovered.header_lost,
        "saved": dict(recovered.saved),
        "lost": _lost_json(recovered.lost),
        "notes": list(recovered.notes),
    }


def recovery_table(good: Path, recovered: RecoveryReport) -> None:
    """Print the saved and the lost messages."""
    header = ["The header is lost: versions, parameters and commands of the run."] * recovered.header_lost
    print_parts(
        [
            f"{sum(recovered.saved.values())} messages saved in {good}",
            *header,
            *(f"{note[0].upper()}{note[1:]}." for note in recovered.notes),
            _lost_table(recovered.lost) if recovered.lost else "Nothing was lost.",
        ]
    )


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


def export_json(log: Log, files: Mapping[str, Path]) -> dict[str, Any]:
    """Return an export as a JSON document."""
    rows = [
        {"topic": topic, "file": str(path), "rows": len(log.time_ns[topic])} for topic, path in files.items()
    ]
    return {"log": str(log.path), "files": rows}


def export_table(log: Log, files: Mapping[str, Path]) -> None:
    """Print the files that were written."""
    print_parts(
        [
            f"{topic:<16} {pluralize(len(log.time_ns[topic]), 'row')} in {path}"
            for topic, path in files.items()
        ]
    )
