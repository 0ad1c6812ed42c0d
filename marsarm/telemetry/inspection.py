"""Summary of a log, selection of its channels by pattern, and a figure of channels over time."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, get_type_hints

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Severity
from marsarm.render.svg import save_figure
from marsarm.telemetry.events import EvrEntry
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.read import Log
from marsarm.telemetry.schema import unit_of
from marsarm.telemetry.topics import PACKET_TOPICS, channel_matches
from sim.scenario.records import suggest_name
from simgap.common.errors import BadRequest

MAX_LOG_S: Final = 9e9
"""Limit of log times; its nanoseconds fit in eight bytes."""
INDEXED_PATTERN: Final = re.compile(r"(.*)\[([0-9]{1,9}(?:,[0-9]{1,9})*)\]")
"""Pattern of a channel, followed by the index of one number."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelSeries:
    """Field of a packet, or one number of it, over the whole log."""

    topic: str
    field: str
    time_ns: NDArray[np.uint64]
    """Log time of each message, shape (n,)."""
    values: NDArray[np.generic]
    """Value in each message, shape (n, ...)."""
    is_truth: bool
    index: tuple[int, ...] = ()
    """Index of the number in its field; () for the whole field."""

    @property
    def name(self) -> str:
        """Name of the channel: /joint.motor_rad or /joint.motor_rad[2]."""
        return f"{self.topic}.{self.field}{index_text(self.index)}"

    @property
    def unit(self) -> str | None:
        """Unit that the suffix of the name gives; "1" for a pure number, None without a suffix."""
        return unit_of(self.field)

    @property
    def type_name(self) -> str:
        """Type and shape: float64[5]."""
        shape = "".join(f"[{n}]" for n in self.values.shape[1:])
        return f"{self.values.dtype.base.name}{shape}"


def index_text(index: tuple[int, ...]) -> str:
    """Format the index of one number of a field: "[2]" or "[0,1]"; empty for ()."""
    return f"[{','.join(map(str, index))}]" if index else ""


def bound_ns(option: str, time_s: float | None) -> int | None:
    """Convert a bound of log time to nanoseconds, None to None; BadRequest if no log has this time."""
    if time_s is None:
        return None
    if not 0.0 <= time_s < MAX_LOG_S:
        raise BadRequest(f"{option}: {time_s} s is no log time; give seconds from 0 on")
    return round(time_s * 1e9)


def severity_name(severity: int) -> str:
    """Return the name of a severity, or its number if the dictionary does not know it."""
    return Severity(severity).name if severity in list(Severity) else str(severity)


def select_channels(log: Log, globs: Sequence[str] = ()) -> tuple[ChannelSeries, ...]:
    """Select the channels that match any of some patterns, in their order; all without a pattern.

    A pattern is /joint.motor_rad or /joint/motor_rad. `*` stands for any letters. An index such as [2] at the
    end selects one number. BadRequest says that a pattern matches none.
    """
    every = [
        ChannelSeries(topic, name, log.time_ns[topic], packets[name], topic in log.truth)
        for topic, packets in sorted(log.packets.items())
        for name in packets.dtype.names or ()
    ]
    found: dict[str, ChannelSeries] = {}
    for glob in globs or ("*",):
        matching = _matching(every, glob)
        if not matching and globs:
            hint = suggest_name(glob.partition("[")[0], [one.name for one in every])
            raise BadRequest(
                f"log {log.path} has no channel {glob}; {hint}`marsarm log info {log.path} '*'` lists them, "
                "and a pattern is written as '/joint.motor_rad*' or '/joint.motor_rad[2]'"
            )
        found |= {one.name: one for one in matching}
    return tuple(found.values())


def _matching(every: Sequence[ChannelSeries], glob: str) -> list[ChannelSeries]:
    """Return the channels, or single numbers of them, that match a pattern."""
    indexed = INDEXED_PATTERN.fullmatch(glob)
    if indexed is None:
        return [one for one in every if channel_matches(one.topic, one.field, glob)]
    index = tuple(map(int, indexed[2].split(",")))
    key: tuple[slice | int, ...] = (slice(None), *index)
    return [
        replace(one, values=one.values[key], index=index)
        for one in _matching(every, indexed[1])
        if index in np.ndindex(*one.values.shape[1:])
    ]


MAX_PANELS: Final = 12
"""Panels in a figure; more would be too small to read."""
MAX_LEGEND: Final = 9
"""Lines that the legend of a panel can name."""
MAX_EVR_NAMES: Final = 12
"""Event reports that are named above the panels."""
COLOURS: Final = {"warning": "#c1121f", "command": "#31688e", "other": "0.75"}


def save_log_figure(channels: Sequence[ChannelSeries], evrs: Sequence[EvrEntry], path: Path) -> str | None:
    """Save the figure as PNG, BadRequest for too many channels, else BadOutput; return why there is none."""
    if len(channels) > MAX_PANELS:
        raise BadRequest(
            f"{len(channels)} channels are selected; a figure has room for {MAX_PANELS}; "
            f"name fewer, such as {channels[0].name}, or draw several"
        )

    def draw(figure: Any) -> None:
        panels = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, channel in zip(panels, channels, strict=True):
            _draw_channel(axes, channel)
            for evr in sorted(evrs, key=lambda evr: evr.severity):  # the severest are drawn last, on top
                axes.axvline(_time_s(evr), color=COLOURS[_colour_key(evr)], linewidth=0.8, zorder=0)
        _label_evrs(panels[0], evrs)
        panels[-1].set_xlabel("log time [s]")

    return save_figure(path, (12, 1.4 + 2.0 * len(channels)), 90, draw)


def _draw_channel(axes: Any, channel: ChannelSeries) -> None:
    time_s = channel.time_ns / 1e9
    flat = channel.values.reshape(len(time_s), -1).astype(float)
    names = _line_names(channel)
    steps = "steps-post" if channel.values.dtype.kind in "biu" else "default"
    # A channel with one message has no line.
    marker = "." if len(time_s) < 2 else None
    for k, name in enumerate(names):
        axes.plot(time_s, flat[:, k], drawstyle=steps, marker=marker, linewidth=1.0, label=name)
    axes.set_title(_title(channel, names), loc="left", fontsize=9)
    axes.set_ylabel(channel.unit or "")
    words = _value_names(channel)
    if words:
        here = [value for value in words if (flat == value).any()]
        axes.set_yticks(here, [words[value] for value in here], fontsize=7)
    else:
        axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(alpha=0.3)
    axes.margins(x=0.01)
    if 1 < len(names) <= MAX_LEGEND:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _title(channel: ChannelSeries, names: Sequence[str | None]) -> str:
    title = f"{channel.name}{' (truth)' if channel.is_truth else ''}"
    if len(names) <= MAX_LEGEND:
        return title
    one = f"{channel.name}{index_text((0,) * (channel.values.ndim - 1))}"
    return f"{title}: {len(names)} lines are too many to name; {one} is one of them"


def _value_names(channel: ChannelSeries) -> dict[int, str]:
    """Return the names of the values of a channel, none if they are plain numbers."""
    topic = PACKET_TOPICS.get(channel.topic)
    kind = None if topic is None else get_type_hints(topic.packet).get(channel.field)
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return {member.value: member.name for member in kind}
    return {}


def _line_names(channel: ChannelSeries) -> list[str | None]:
    """Return the label of each line: joint or index; None for a single number."""
    shape = channel.values.shape[1:]
    if shape == (len(Joint),) and channel.topic in PACKET_TOPICS:
        return [joint.name.lower() for joint in Joint]
    return [", ".join(map(str, index)) or None for index in np.ndindex(*shape)]


def _label_evrs(axes: Any, evrs: Sequence[EvrEntry]) -> None:
    """Write names of events above the first panel, the severest first, where they do not overlap.

    The title counts the events without a name.
    """
    low, high = axes.get_xlim()
    named: list[float] = []
    for evr in sorted(evrs, key=lambda evr: (-evr.severity, evr.tick)):
        at = _time_s(evr)
        if len(named) < MAX_EVR_NAMES and all(abs(at - other) > 0.03 * (high - low) for other in named):
            named.append(at)
            axes.annotate(
                evr.name,
                (at, 1.0),
                (0, 16),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                rotation=30,
                fontsize=7,
                color=COLOURS[_colour_key(evr)] if _colour_key(evr) != "other" else "0.4",
                annotation_clip=False,
            )
    if len(named) < len(evrs):
        axes.set_title(
            f"{len(evrs) - len(named)} more events, not named", loc="right", fontsize=7, color="0.4"
        )


def _time_s(evr: EvrEntry) -> float:
    return evr.tick * TICK_NS / 1e9


def _colour_key(evr: EvrEntry) -> str:
    if evr.severity >= Severity.WARNING_LO:
        return "warning"
    return "command" if evr.severity == Severity.COMMAND else "other"
