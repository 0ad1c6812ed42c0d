"""What a log holds, in numbers: its run as a whole, and each of its channels."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.evrs import Severity
from ground.common.fields import unit_of
from ground.telemetry.format import TICK_NS
from ground.telemetry.read import Log
from sim.scenario.names import did_you_mean

MAX_LOG_S: Final = 9e9
"""No log is as long; its nanoseconds still have room in eight bytes."""
INDEXED_PATTERN: Final = re.compile(r"(.*)\[([0-9]{1,9}(?:,[0-9]{1,9})*)\]")
"""A pattern with the place of one number behind it."""


class NoSuchChannel(ValueError):
    """A log has no channel, or no topic, that this name fits."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log; `rate_hz` is over the whole log."""

    name: str
    messages: int
    rate_hz: float
    is_truth: bool


@dataclass(frozen=True, slots=True)
class LogInfo:
    """A log as a whole; `cycles` counts those in which anything was written."""

    first_s: float | None
    duration_s: float
    cycles: int
    topics: tuple[TopicInfo, ...]
    evrs: dict[str, int]
    """How many of each severity there are, the gravest first."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelSeries:
    """A field of a packet, or one number of it, over the whole log.

    `values` has shape (n, ...), one for each of `time_ns`.
    """

    topic: str
    field: str
    time_ns: NDArray[np.uint64]
    values: NDArray[np.generic]
    is_truth: bool
    place: tuple[int, ...] = ()
    """Which number of the field it is; () for the whole field."""

    @property
    def name(self) -> str:
        """What it is called everywhere: /joint.motor_rad, /joint.motor_rad[2]."""
        return f"{self.topic}.{self.field}{index_text(self.place)}"

    @property
    def unit(self) -> str | None:
        """From the suffix of the name, "1" for a pure number; None where the name tells none."""
        return unit_of(self.field)

    @property
    def type_name(self) -> str:
        """Kind of number and shape: float64[5]."""
        shape = "".join(f"[{n}]" for n in self.values.shape[1:])
        return f"{self.values.dtype.base.name}{shape}"


@dataclass(frozen=True, slots=True)
class Range:
    """The finite values of a channel; None where there are none."""

    low: float | int | None
    high: float | int | None
    not_finite: int


def index_text(place: tuple[int, ...]) -> str:
    """How one number of a field is told from the others, as in tables: [2], [0,1]; nothing for ()."""
    return f"[{','.join(map(str, place))}]" if place else ""


def summarize_log(log: Log) -> LogInfo:
    """The log in a few numbers."""
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
        evrs={severity_name(grade): counts[grade] for grade in sorted(counts, reverse=True)},
    )


def bound_ns(option: str, time_s: float | None) -> int | None:
    """A bound of log time; NoSuchChannel where it is no time that a log can have."""
    if time_s is None:
        return None
    if not 0.0 <= time_s < MAX_LOG_S:
        raise NoSuchChannel(f"{option}: {time_s} s is no log time; give seconds from 0 on")
    return round(time_s * 1e9)


def severity_name(grade: int) -> str:
    """A severity by name; its number where this dictionary has none."""
    return Severity(grade).name if grade in list(Severity) else str(grade)


def select_channels(log: Log, globs: Sequence[str] = ()) -> tuple[ChannelSeries, ...]:
    """The channels that any of these patterns fits, in the order of the patterns; all without one.

    A pattern is as /joint.motor_rad, or /joint/motor_rad, * being any letters; [2] behind it is one number.

    Raises:
        NoSuchChannel: a pattern fits none.
    """
    every = [
        ChannelSeries(topic, name, log.time_ns[topic], packets[name], topic in log.truth)
        for topic, packets in sorted(log.packets.items())
        for name in packets.dtype.names or ()
    ]
    found: dict[str, ChannelSeries] = {}
    for glob in globs or ("*",):
        fitting = _matching(every, glob)
        if not fitting and globs:
            hint, _, _ = did_you_mean(glob, [one.name for one in every]).rpartition("there are ")
            raise NoSuchChannel(
                f"log {log.path} has no channel {glob}; {hint}`marsarm log channels {log.path}` lists them, "
                "and a pattern is written as '/joint.motor_rad*' or '/joint.motor_rad[2]'"
            )
        found |= {one.name: one for one in fitting}
    return tuple(found.values())


def _matching(every: Sequence[ChannelSeries], glob: str) -> list[ChannelSeries]:
    """The channels, or numbers of them, that a pattern fits."""
    numbered = INDEXED_PATTERN.fullmatch(glob)
    if numbered is not None:
        base, place = numbered[1], tuple(map(int, numbered[2].split(",")))
        return [_select_number(one, place) for one in every if _fits(one, base) and _has_index(one, place)]
    return [one for one in every if _fits(one, glob)]


def _fits(channel: ChannelSeries, glob: str) -> bool:
    return any(fnmatchcase(f"{channel.topic}{mark}{channel.field}", glob) for mark in "./")


def _has_index(channel: ChannelSeries, place: tuple[int, ...]) -> bool:
    shape = channel.values.shape[1:]
    return len(shape) == len(place) and all(k < size for k, size in zip(place, shape, strict=True))


def _select_number(channel: ChannelSeries, place: tuple[int, ...]) -> ChannelSeries:
    index: tuple[slice | int, ...] = (slice(None), *place)
    return replace(channel, values=channel.values[index], place=place)


def range_of(channel: ChannelSeries) -> Range:
    """The least and the greatest value, and how many are NaN or infinite."""
    values = channel.values
    if values.dtype.kind == "b":
        values = values.astype(np.int8)
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Range(None, None, values.size)
    low, high = finite.min().item(), finite.max().item()
    return Range(low, high, values.size - finite.size)
