"""Figure of channels over time, one panel each, with event reports as vertical lines."""

from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, get_type_hints

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Severity
from marsarm.render.svg import save_figure
from marsarm.telemetry.events import EvrEntry
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.inspection import ChannelSeries, index_text
from marsarm.telemetry.topics import PACKET_TOPICS
from simgap.common.errors import BadRequest

MAX_PANELS: Final = 12
"""Panels in a figure; more would be too small to read."""
MAX_LEGEND: Final = 9
"""Lines that the legend of a panel can name."""
MAX_EVR_NAMES: Final = 12
"""Event reports that are named above the panels."""
COLOURS: Final = {"warning": "#c1121f", "command": "#31688e", "other": "0.75"}


class TooManyChannels(BadRequest):
    """Error of a request for more channels than a figure has panels."""


def save_log_figure(channels: Sequence[ChannelSeries], evrs: Sequence[EvrEntry], path: Path) -> str | None:
    """Save the figure as PNG.

    Returns:
        None, or why there is no figure: matplotlib is not installed.

    Raises:
        TooManyChannels: there are more channels than panels.
        BadOutput: the file cannot be written.
    """
    if len(channels) > MAX_PANELS:
        raise TooManyChannels(
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
    for topic, _ in PACKET_TOPICS:
        if topic.name == channel.topic and channel.field in topic.field_names:
            kind = get_type_hints(topic.packet)[channel.field]
            if isinstance(kind, type) and issubclass(kind, IntEnum):
                return {member.value: member.name for member in kind}
    return {}


def _line_names(channel: ChannelSeries) -> list[str | None]:
    """Return the label of each line: joint or index; None for a single number."""
    shape = channel.values.shape[1:]
    if shape == (len(Joint),) and channel.topic in {topic.name for topic, _ in PACKET_TOPICS}:
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
