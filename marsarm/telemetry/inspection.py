"""Selection of the channels of a log by pattern."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.evrs import Severity
from marsarm.telemetry.read import Log
from marsarm.telemetry.schema import unit_of
from marsarm.telemetry.topics import channel_matches
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
