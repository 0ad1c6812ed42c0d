"""Output of the verbs of `marsarm log`: tables for people and JSON documents."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from marsarm.telemetry.errors import (
    LostMessages,
    span_text,
    trailing_bytes_text,
)
from marsarm.telemetry.format import FORMAT
from marsarm.telemetry.inspection import ChannelSeries, LogInfo, Range, range_of, summarize_log
from marsarm.telemetry.read import Log
from marsarm.telemetry.recover import RecoveryReport
from simgap.common.console import plain_console, pluralize

OMITTED_KEYS: Final = ("channels", "commands", "params")
"""Keys of the header that are too long for people."""
PIPE_WIDTH: Final = 120
"""Width of a table that goes into a file or a pipe."""
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
        "lost": lost_json(log.lost),
    }


def _parse_header_value(name: str, text: str) -> Any:
    try:
        return json.loads(text) if name in JSON_KEYS else text
    except ValueError:
        return text


def lost_json(lost: Sequence[LostMessages]) -> list[dict[str, Any]]:
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
    console, info = plain_console(), summarize_log(log)
    for name, text in sorted(log.header.items()):
        if name not in OMITTED_KEYS:
            console.print(f"{name:<16}  {text}", markup=False, soft_wrap=True)
    console.print(f"{'format':<16}  {FORMAT}")
    console.print(f"{'duration':<16}  {_duration(info)}")
    state = log.end_note or log.end
    if log.trailing_bytes:
        state += f"; {trailing_bytes_text(log.trailing_bytes)}"
    console.print(f"{'end':<16}  {state}", soft_wrap=True)
    table = Table()
    for name in ("topic", "messages", "rate Hz", ""):
        table.add_column(name, justify="left" if name in ("topic", "") else "right")
    for one in info.topics:
        table.add_row(one.name, str(one.messages), f"{one.rate_hz:.2f}", "truth" if one.is_truth else "")
    console.print(table)
    evrs = ", ".join(f"{count} {name}" for name, count in info.evrs.items())
    console.print(f"EVRs: {evrs or 'none'}")
    if log.lost:
        console.print("This log was recovered from a damaged one.")
        _lost_table(console, log.lost)


def _duration(info: LogInfo) -> str:
    if info.first_s is None:
        return "nothing was recorded"
    return f"{info.duration_s:.3f} s from {info.first_s:.3f} s on, {info.cycles} cycles"


def channels_json(log: Log, channels: Sequence[ChannelSeries]) -> dict[str, Any]:
    """Return the channels of a log as a JSON document."""
    return {"log": str(log.path), "channels": [_channel_json(one, range_of(one)) for one in channels]}


def _channel_json(channel: ChannelSeries, values: Range) -> dict[str, Any]:
    return {
        "channel": channel.name,
        "type": channel.type_name,
        "unit": channel.unit,
        "truth": channel.is_truth,
        "messages": len(channel.time_ns),
        "min": values.low,
        "max": values.high,
        "not_finite": values.not_finite,
    }


def channels_table(channels: Sequence[ChannelSeries]) -> None:
    """Print the channels of a log, one in each line."""
    table = Table(box=None, pad_edge=False)
    for name in ("channel", "type", "unit", "count", "min", "max", "NaN, inf"):
        is_text = name in ("channel", "type", "unit")
        table.add_column(name, justify="left" if is_text else "right", no_wrap=True)
    for one in channels:
        values = range_of(one)
        table.add_row(
            one.name,
            one.type_name,
            one.unit or "",
            str(len(one.time_ns)),
            _number(values.low),
            _number(values.high),
            str(values.not_finite or ""),
        )
    plain_console(None if Console().is_terminal else PIPE_WIDTH).print(table)


def _number(value: float | int | None) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def recovery_json(bad: Path, good: Path, recovered: RecoveryReport) -> dict[str, Any]:
    """Return a recovery as a JSON document."""
    return {
        "bad": str(bad),
        "good": str(good),
        "header_lost": recovered.header_lost,
        "saved": dict(recovered.saved),
        "lost": lost_json(recovered.lost),
        "notes": list(recovered.notes),
    }


def recovery_table(good: Path, recovered: RecoveryReport) -> None:
    """Print the saved and the lost messages."""
    console = plain_console()
    console.print(f"{sum(recovered.saved.values())} messages saved in {good}", soft_wrap=True)
    if recovered.header_lost:
        console.print("The header is lost: versions, parameters and commands of the run.")
    for note in recovered.notes:
        console.print(f"{note[0].upper()}{note[1:]}.", soft_wrap=True)
    if recovered.lost:
        _lost_table(console, recovered.lost)
    else:
        console.print("Nothing was lost.")


def _lost_table(console: Console, lost: Sequence[LostMessages]) -> None:
    table = Table(title="lost", title_justify="left")
    table.add_column("topic")
    table.add_column("messages", justify="right")
    table.add_column("log time")
    for one in lost:
        count = "unknown" if one.count is None else str(one.count)
        table.add_row(one.topic or "all", count, span_text(one.after_ns, one.before_ns))
    console.print(table)


def export_json(log: Log, files: dict[str, Path]) -> dict[str, Any]:
    """Return an export as a JSON document."""
    rows = {topic: len(log.time_ns[topic]) for topic in files}
    return {
        "log": str(log.path),
        "files": [{"topic": topic, "file": str(path), "rows": rows[topic]} for topic, path in files.items()],
    }


def export_table(log: Log, files: dict[str, Path]) -> None:
    """Print the files that were written."""
    for topic, path in files.items():
        plain_console().print(
            f"{topic:<16} {pluralize(len(log.time_ns[topic]), 'row')} in {path}", soft_wrap=True
        )
