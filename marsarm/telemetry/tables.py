"""Reports of the verbs of `marsarm log`: documents, and tables and sentences for people."""

import json
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from marsarm.telemetry.format import FORMAT, TICK_NS, LostMessages, span_text, trailing_bytes_text
from marsarm.telemetry.inspection import ChannelSeries, severity_name
from marsarm.telemetry.read import Log
from marsarm.telemetry.recover import RecoveryReport
from simgap.common.console import pluralize
from simgap.common.report import ReportTable

OMITTED_KEYS: Final = ("channels", "commands", "params")
"""Keys of the header that are too long for people."""
JSON_KEYS: Final = ("boot", "cpu", "effects", "request", "session", "world")
"""Keys of the header whose values are JSON."""

LABEL_WIDTH: Final = 18
LINE_WIDTH: Final = 100


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
    if isinstance(value, float):
        return f"{value:.6g}"
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


def _wrap(line: str) -> str:
    """Return a line with its label in lines of LINE_WIDTH; a path stays whole."""
    indent = " " * LABEL_WIDTH
    return textwrap.fill(
        line, LINE_WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


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
        *(_wrap(f"{name:<{LABEL_WIDTH}}{text}") for name, text in about.items()),
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
