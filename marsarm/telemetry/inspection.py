"""Summary of a log, selection of its channels by pattern, and the range of a channel."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.evrs import Severity
from marsarm.common.fields import unit_of
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.read import Log
from marsarm.telemetry.topics import channel_matches
from sim.scenario.names import suggest_name
from simgap.common.errors import BadRequest

MAX_LOG_S: Final = 9e9
"""Limit of log times; its nanoseconds fit in eight bytes."""
INDEXED_PATTERN: Final = re.compile(r"(.*)\[([0-9]{1,9}(?:,[0-9]{1,9})*)\]")
"""Pattern of a channel, followed by the index of one number."""


class NoSuchChannel(BadRequest):
    """Error of a name or pattern that matches no channel or topic of a log."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """Topic of a log; `rate_hz` is the mean over the whole log."""

    name: str
    messages: int
    rate_hz: float
    is_truth: bool


@dataclass(frozen=True, slots=True)
class LogInfo:
    """Summary of a log; `cycles` counts the cycles with at least one message."""

    first_s: float | None
    duration_s: float
    cycles: int
    topics: tuple[TopicInfo, ...]
    evrs: dict[str, int]
    """Number of EVRs by severity, the severest first."""


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


@dataclass(frozen=True, slots=True)
class Range:
    """Range of the finite values of a channel; None if there are none."""

    low: float | int | None
    high: float | int | None
    not_finite: int


def index_text(index: tuple[int, ...]) -> str:
    """Format the index of one number of a field: "[2]" or "[0,1]"; empty for ()."""
    return f"[{','.join(map(str, index))}]" if index else ""


def summarize_log(log: Log) -> LogInfo:
    """Summarize a log."""
    times = [time_ns for time_ns in log.time_ns.values() if len(time_ns)]
    cycles = np.unique(np.concatenate(times)) if times else np.zeros(0, np.uint64)
    duration_s = (int(cycles[-1]) - int(cycles[0]) + TICK_NS) / 1e9 if len(cycles) else 0.0
    topics = (
        TopicInfo(name, len(time_ns), len(time_ns) / duration_s, name in log.truth)
        for name, time_ns in sorted(log.time_ns.items())
    )
    counts = Counter(evr.severity for evr in log.evrs)
    return LogInfo(
        first_s=int(cycles[0]) / 1e9 if len(cycles) else None,
        duration_s=duration_s,
        cycles=len(cycles),
        topics=tuple(topics),
        evrs={severity_name(severity): counts[severity] for severity in sorted(counts, reverse=True)},
    )


def bound_ns(option: str, time_s: float | None) -> int | None:
    """Convert a bound of log time to nanoseconds; None stays None.

    Args:
        option: Name of the bound, for the message.
        time_s: Log time.

    Raises:
        NoSuchChannel: no log has this time.
    """
    if time_s is None:
        return None
    if not 0.0 <= time_s < MAX_LOG_S:
        raise NoSuchChannel(f"{option}: {time_s} s is no log time; give seconds from 0 on")
    return round(time_s * 1e9)


def severity_name(severity: int) -> str:
    """Return the name of a severity, or its number if the dictionary does not know it."""
    return Severity(severity).name if severity in list(Severity) else str(severity)


def select_channels(log: Log, globs: Sequence[str] = ()) -> tuple[ChannelSeries, ...]:
    """Select the channels that match any of some patterns, in their order; all without a pattern.

    A pattern is /joint.motor_rad or /joint/motor_rad. `*` stands for any letters. An index such as [2] at the
    end selects one number.

    Raises:
        NoSuchChannel: a pattern matches no channel.
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
            raise NoSuchChannel(
                f"log {log.path} has no channel {glob}; {hint}`marsarm log info {log.path} '*'` lists them, "
                "and a pattern is written as '/joint.motor_rad*' or '/joint.motor_rad[2]'"
            )
        found |= {one.name: one for one in matching}
    return tuple(found.values())


def _matching(every: Sequence[ChannelSeries], glob: str) -> list[ChannelSeries]:
    """Return the channels, or single numbers of them, that match a pattern."""
    indexed = INDEXED_PATTERN.fullmatch(glob)
    if indexed is not None:
        base, index = indexed[1], tuple(map(int, indexed[2].split(",")))
        return [
            _select_number(one, index)
            for one in every
            if channel_matches(one.topic, one.field, base) and _has_index(one, index)
        ]
    return [one for one in every if channel_matches(one.topic, one.field, glob)]


def _has_index(channel: ChannelSeries, index: tuple[int, ...]) -> bool:
    shape = channel.values.shape[1:]
    return len(shape) == len(index) and all(k < size for k, size in zip(index, shape, strict=True))


def _select_number(channel: ChannelSeries, index: tuple[int, ...]) -> ChannelSeries:
    key: tuple[slice | int, ...] = (slice(None), *index)
    return replace(channel, values=channel.values[key], index=index)


def range_of(channel: ChannelSeries) -> Range:
    """Return the smallest and the largest finite value, and the number of NaN and infinite values."""
    values = channel.values
    if values.dtype.kind == "b":
        values = values.astype(np.int8)
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Range(None, None, values.size)
    low, high = finite.min().item(), finite.max().item()
    return Range(low, high, values.size - finite.size)
