"""Report of a replay: its document, and what it shows on the console."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from fsw.config import CYCLE_HZ
from marsarm.replaying.compare import ChannelDifference, Differences, EvrDifference
from marsarm.replaying.replay import ReplayReport
from marsarm.telemetry.events import EvrEntry
from simgap.common.console import magnitude_sparkline, pluralize, value_sparklines

MAX_EVRS: Final = 30
"""Events on the console; the document has all."""


def replay_document(report: ReplayReport) -> dict[str, Any]:
    """Collect a replay and its differences from the recorded run."""
    found, header = report.differences, report.header
    return {
        "log": report.request.log,
        "recorded_by": {key: header.get(key) for key in ("marsarm", "git", "numpy", "mujoco", "python")},
        "same_processor": report.same_processor,
        "changed_params": report.changed_params,
        "notes": report.notes,
        "identical": found.identical,
        "tolerance": found.tolerance,
        "ticks": _sides(*found.ticks),
        "evrs": [
            {
                "kind": one.kind,
                "tick": one.tick,
                **_sides(_evr_document(one.recorded), _evr_document(one.replayed)),
            }
            for one in found.evrs
        ],
        "lengths": found.lengths,
        "channels": [_channel_document(one) for one in found.channels],
        "channels_compared": found.channels_compared,
        "not_compared": found.not_compared,
    }


def _sides(recorded: Any, replayed: Any) -> dict[str, Any]:
    return {"recorded": recorded, "replayed": replayed}


def _evr_document(evr: EvrEntry | None) -> dict[str, Any] | None:
    if evr is None:
        return None
    return {"tick": evr.tick, "name": evr.name, "message": evr.message, "fields": evr.fields}


def _channel_document(one: ChannelDifference) -> dict[str, Any]:
    """Collect a channel that differs; a line of text stands for its differences at all ticks."""
    return {
        **{name: value for name, value in asdict(one).items() if name not in ("profile", *_sides(0, 0))},
        "at_first": _sides(*one.at_first),
        "waveform": magnitude_sparkline(one.profile),
        "around_first": _sides(one.recorded, one.replayed),
    }


def replay_parts(report: ReplayReport) -> list[str]:
    """Show a replay: events first, then lengths, then channel by channel."""
    header = report.header
    processor = (
        "processor another than recorded it (cpu in the header): numbers are compared to "
        f"{report.differences.tolerance:g}"
    )
    return [
        f"{report.request.log}: {verdict_line(report.differences)}",
        f"recorded  by marsarm {header.get('marsarm')}, git {header.get('git')}, numpy {header.get('numpy')}",
        *([] if report.same_processor else [processor]),
        *(f"parameter {line}" for line in report.changed_params),
        *(f"note      {line}" for line in report.notes),
        *difference_lines(report.differences),
    ]


def verdict_line(found: Differences) -> str:
    """Return one line that says whether two runs are the same."""
    ticks = f"{pluralize(found.ticks[0], 'tick')}, {found.ticks[0] / CYCLE_HZ:.1f} s"
    if found.identical:
        same = "identical" if found.tolerance == 0 else f"the same to {found.tolerance:g}"
        return f"{same}: {ticks}, {pluralize(found.channels_compared, 'channel')}"
    return (
        f"DIFFERENT: {pluralize(len(found.evrs), 'event')}, {pluralize(len(found.lengths), 'length')}, "
        f"{len(found.channels)} of {pluralize(found.channels_compared, 'channel')}; "
        f"{ticks}, {found.ticks[1]} replayed"
    )


def difference_lines(found: Differences) -> Iterator[str]:
    """Yield the lines of the differences between two runs."""
    yield from (f"note      {line}" for line in found.not_compared)
    yield from (_evr_line(one) for one in found.evrs[:MAX_EVRS])
    if len(found.evrs) > MAX_EVRS:
        yield f"event     and {len(found.evrs) - MAX_EVRS} more; --json lists all"
    for n in found.lengths:
        yield (
            f"length    {n.topic}: {n.recorded} recorded, {n.replayed} replayed, apart from tick "
            f"{n.first_tick} on"
        )
    for c in sorted(found.channels, key=lambda c: c.first_tick):
        yield from _channel_lines(c)


def _channel_lines(c: ChannelDifference) -> Iterator[str]:
    """Yield the lines of a channel: its difference, the course over time, values at the first tick."""
    yield (
        f"channel   {_component_name(c.channel, c.component)}: from tick {c.first_tick} on, at {c.ticks} of "
        f"{c.compared} ticks, by up to {c.greatest:.3g} at tick {c.greatest_tick}"
    )
    yield f"          {'difference over time':<20}  {magnitude_sparkline(c.profile)}"
    lines = value_sparklines(c.recorded.astype(np.float64), c.replayed.astype(np.float64))
    where = "" if c.component == c.first_component else f" of {_component_name(c.channel, c.first_component)}"
    for side, line, value in zip(("recorded", "replayed"), lines, c.at_first, strict=True):
        yield f"          {f'{side} at first':<20}  {line}  {value!r} at tick {c.first_tick}{where}"


def _evr_line(one: EvrDifference) -> str:
    evr = one.recorded or one.replayed
    assert evr is not None
    line = f"event     tick {evr.tick}  {one.kind.value}  {evr.name}: {evr.message}"
    if one.recorded is None or one.replayed is None:
        return line
    later = "" if one.recorded.tick == one.replayed.tick else f"at tick {one.replayed.tick} "
    return f"{line}  ->  {later}{one.replayed.name}: {one.replayed.message}"


def _component_name(channel: str, component: tuple[int, ...]) -> str:
    return channel + "".join(f"[{k}]" for k in component)
