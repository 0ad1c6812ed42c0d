"""Output of a replay: a table for people and a JSON document."""

from collections.abc import Iterator
from math import isfinite
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape

from fsw.config import CYCLE_HZ
from marsarm.replaying.compare import ChannelDifference, Differences, EvrDifference
from marsarm.replaying.replay import ReplayReport
from marsarm.telemetry.events import EvrEntry
from simgap.common.console import magnitude_sparkline, pluralize, value_sparklines

MAX_EVRS: Final = 30
"""Events in the table; the JSON document has all."""


def replay_json(report: ReplayReport) -> dict[str, Any]:
    """Return a replay as a JSON document."""
    return {
        "log": str(report.request.log),
        "recorded_by": {
            key: report.header.get(key) for key in ("marsarm", "git", "numpy", "mujoco", "python")
        },
        "same_processor": report.same_processor,
        "changed_params": list(report.changed_params),
        "notes": list(report.notes),
        **differences_json(report.differences),
    }


def differences_json(found: Differences) -> dict[str, Any]:
    """Return the differences between two runs as a JSON document."""
    return {
        "identical": found.identical,
        "tolerance": found.tolerance,
        "ticks": {"recorded": found.ticks[0], "replayed": found.ticks[1]},
        "evrs": [
            {
                "kind": one.kind.value,
                "tick": one.tick,
                "recorded": _evr_document(one.recorded),
                "replayed": _evr_document(one.replayed),
            }
            for one in found.evrs
        ],
        "lengths": [
            {"topic": n.topic, "recorded": n.recorded, "replayed": n.replayed, "first_tick": n.first_tick}
            for n in found.lengths
        ],
        "channels": [_channel_document(one) for one in found.channels],
        "channels_compared": found.channels_compared,
        "not_compared": list(found.not_compared),
    }


def replay_table(report: ReplayReport) -> None:
    """Print a replay: events first, then lengths, then channel by channel."""
    console = Console(highlight=False)
    console.print(f"{report.request.log}: {verdict_line(report.differences)}", soft_wrap=True, markup=False)
    header = report.header
    console.print(
        f"recorded  by marsarm {header.get('marsarm')}, git {header.get('git')}, numpy {header.get('numpy')}",
        soft_wrap=True,
    )
    if not report.same_processor:
        console.print(
            f"processor another than recorded it (cpu in the header): numbers are compared to "
            f"{report.differences.tolerance:g}",
            soft_wrap=True,
        )
    for name, lines in (("parameter", report.changed_params), ("note", report.notes)):
        for line in lines:
            console.print(f"{name:<9} {line}", soft_wrap=True, markup=False)
    differences_table(console, report.differences)


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


def differences_table(console: Console, found: Differences) -> None:
    """Print the differences between two runs."""
    for line in found.not_compared:
        console.print(f"note      {line}", soft_wrap=True, markup=False)
    for one in found.evrs[:MAX_EVRS]:
        console.print(_evr_line(one), soft_wrap=True)
    if len(found.evrs) > MAX_EVRS:
        console.print(f"event     and {len(found.evrs) - MAX_EVRS} more; --json lists all")
    for n in found.lengths:
        console.print(
            f"length    {n.topic}: {n.recorded} recorded, {n.replayed} replayed, apart from tick "
            f"{n.first_tick} on",
            soft_wrap=True,
        )
    for c in sorted(found.channels, key=lambda c: c.first_tick):
        for line in _channel_lines(c):
            console.print(line, soft_wrap=True, markup=False)


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
    line = f"event     tick {evr.tick}  [bold]{one.kind.value}[/bold]  {evr.name}: {escape(evr.message)}"
    if one.recorded is None or one.replayed is None:
        return line
    later = "" if one.recorded.tick == one.replayed.tick else f"at tick {one.replayed.tick} "
    return f"{line}  ->  {later}{one.replayed.name}: {escape(one.replayed.message)}"


def _evr_document(evr: EvrEntry | None) -> dict[str, Any] | None:
    if evr is None:
        return None
    return {"tick": evr.tick, "name": evr.name, "message": evr.message, "fields": _finite_json(evr.fields)}


def _channel_document(one: ChannelDifference) -> dict[str, Any]:
    return {
        "channel": one.channel,
        "first_tick": one.first_tick,
        "first_component": list(one.first_component),
        "at_first": {"recorded": _finite_json(one.at_first[0]), "replayed": _finite_json(one.at_first[1])},
        "ticks": one.ticks,
        "compared": one.compared,
        "greatest": _finite_json(one.greatest),
        "greatest_tick": one.greatest_tick,
        "component": list(one.component),
        "waveform": magnitude_sparkline(one.profile),
        "around_first": {
            "recorded": _finite_json(one.recorded.tolist()),
            "replayed": _finite_json(one.replayed.tolist()),
        },
    }


def _component_name(channel: str, component: tuple[int, ...]) -> str:
    return channel + "".join(f"[{k}]" for k in component)


def _finite_json(value: Any) -> Any:
    """Convert NaN and infinities to text, since strict JSON lacks them."""
    if isinstance(value, dict):
        return {key: _finite_json(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite_json(item) for item in value]
    return str(value) if isinstance(value, float) and not isfinite(value) else value
