"""Comparison of two runs: events that are missing, added or changed, and channels that differ."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import zip_longest
from math import isfinite, isnan
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from marsarm.replaying.inputs import Behaviour, TopicSeries
from marsarm.telemetry.events import EvrEntry
from marsarm.telemetry.format import DRIVE_TOPIC, EVR_TOPIC
from marsarm.telemetry.topics import channel_name


class EvrChange(StrEnum):
    """Kind of difference of an event."""

    MISSING = "missing"
    """Recorded, not replayed."""
    ADDED = "added"
    """Replayed, not recorded."""
    CHANGED = "changed"
    """Another one replayed in its place, or with other fields."""


@dataclass(frozen=True, slots=True)
class EvrDifference:
    """Place in the order of events of a tick whose event differs; it may be None in one run."""

    kind: EvrChange
    recorded: EvrEntry | None
    replayed: EvrEntry | None

    @property
    def event(self) -> EvrEntry:
        """Recorded event, else the replayed one."""
        event = self.recorded or self.replayed
        assert event is not None
        return event


def evr_differences(
    recorded: Sequence[EvrEntry], replayed: Sequence[EvrEntry], tolerance: float = 0.0
) -> Iterator[EvrDifference]:
    """Yield the differences between events, compared tick by tick in their order."""
    ticks: dict[int, tuple[list[EvrEntry], list[EvrEntry]]] = defaultdict(lambda: ([], []))
    for side, evrs in enumerate((recorded, replayed)):
        for evr in evrs:
            ticks[evr.tick][side].append(evr)
    for tick in sorted(ticks):
        for one, other in zip_longest(*ticks[tick]):
            if one is None:
                yield EvrDifference(EvrChange.ADDED, None, other)
            elif other is None:
                yield EvrDifference(EvrChange.MISSING, one, None)
            elif not _evrs_equal(one, other, tolerance):
                yield EvrDifference(EvrChange.CHANGED, one, other)


def _evrs_equal(one: EvrEntry, other: EvrEntry, tolerance: float) -> bool:
    if tolerance == 0.0:
        return one == other
    # Messages contain rounded numbers, which may differ although the fields agree within the tolerance.
    alike = (one.name, one.severity) == (other.name, other.severity)
    return alike and _values_close(one.fields, other.fields, tolerance)


def _values_close(a: Any, b: Any, tolerance: float) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_values_close(a[k], b[k], tolerance) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_values_close(x, y, tolerance) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        near = isfinite(a - b) and abs(a - b) <= tolerance * max(1.0, abs(a))
        return near or a == b or (isnan(a) and isnan(b))
    return bool(a == b)


MIN_DIFFERENCE: Final = np.finfo(np.float64).smallest_subnormal.item()
"""Difference that is reported for 0.0 and -0.0, which are not the same."""


def array_difference(a: NDArray[Any], b: NDArray[Any], tolerance: float) -> NDArray[np.float64]:
    """Compute the absolute difference of each pair of numbers, (...): 0 only if they are the same.

    It is infinite if only one of them is NaN, and at least MIN_DIFFERENCE if they differ, as 0.0 and -0.0 do.
    The tolerance is relative for numbers beyond 1, absolute below; 0 compares bit for bit.
    """
    x, y, least = a.astype(np.float64), b.astype(np.float64), MIN_DIFFERENCE
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.abs(x - y)
    if {a.dtype.kind, b.dtype.kind} != {"f"}:
        same, least = a == b, 1.0  # large integers are not exact as floats
    elif tolerance == 0.0:
        same = (x.view(np.int64) == y.view(np.int64)) | (np.isnan(x) & np.isnan(y))
    else:
        near = np.isfinite(distance) & (distance <= tolerance * np.maximum(1.0, np.abs(x)))
        same = (a == b) | near | (np.isnan(x) & np.isnan(y))
    return np.where(same, 0.0, np.where(np.isnan(distance), np.inf, np.maximum(distance, least)))


ChannelFilter = Callable[[str, str], bool]
"""Function of topic and field that returns whether to compare the channel."""
Number = float | int | bool


@dataclass(frozen=True, slots=True)
class LengthDifference:
    """Topic with messages at ticks where the other run has none."""

    topic: str
    recorded: int
    replayed: int
    first_tick: int
    """First tick with a message in only one run."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDifference:
    """Channel whose values differ; an array is one channel, compared component by component."""

    channel: str
    first_tick: int
    first_component: tuple[int, ...]
    """Index of the component that differs most at the first tick; () for a single number."""
    at_first: tuple[Number, Number]
    """Recorded and replayed value of that component at the first tick."""
    ticks: int
    """Number of ticks at which the channel differs."""
    compared: int
    """Number of ticks at which it was compared."""
    greatest: float
    """Greatest difference, as `array_difference` computes it."""
    greatest_tick: int
    component: tuple[int, ...]
    """Index of the component with the greatest difference."""
    profile: NDArray[np.float64]
    """Greatest difference of any component at each compared tick, shape (compared,)."""


@dataclass(frozen=True, slots=True)
class Differences:
    """Differences between a recorded and a replayed run."""

    tolerance: float
    ticks: tuple[int, int]
    """Number of recorded and of replayed ticks."""
    lengths: tuple[LengthDifference, ...]
    evrs: tuple[EvrDifference, ...]
    channels: tuple[ChannelDifference, ...]
    channels_compared: int
    not_compared: tuple[str, ...]
    """Sentences about topics and channels that only one run has."""
    driven_tick: int | None
    """First tick with another drive, also if its channels are not chosen; None if the drive is the same."""

    @property
    def identical(self) -> bool:
        """True if all compared values are the same."""
        same_length = self.ticks[0] == self.ticks[1]
        return same_length and not (self.lengths or self.evrs or self.channels)


def compare_behaviours(
    recorded: Behaviour,
    replayed: Behaviour,
    tolerance: float = 0.0,
    chosen: ChannelFilter = lambda topic, field: True,
) -> Differences:
    """Compare two runs, in chosen channels, lengths and events; NaN equals NaN.

    The tolerance is that of `array_difference`; integers and flags must be equal.
    """
    topics = list(dict.fromkeys((*recorded.series, *replayed.series)))
    lengths = [_length_difference(topic, recorded, replayed) for topic in topics]
    lengths.append(_evr_length_difference(recorded, replayed))
    not_compared, channels, compared, driven = list[str](), [], 0, list[int]()
    for topic in topics:
        ours, theirs = recorded.series.get(topic), replayed.series.get(topic)
        if ours is None or theirs is None:
            continue
        comparable, sentences = _comparable(topic, ours, theirs)
        not_compared += sentences
        for name in comparable:
            is_chosen = chosen(topic, name)
            compared += is_chosen
            if not is_chosen and topic != DRIVE_TOPIC:
                continue
            one = _channel_difference(channel_name(topic, name), name, ours, theirs, tolerance)
            if one is not None and topic == DRIVE_TOPIC:
                driven.append(one.first_tick)
            if one is not None and is_chosen:
                channels.append(one)
    return Differences(
        tolerance=tolerance,
        ticks=(recorded.ticks, replayed.ticks),
        lengths=tuple(one for one in lengths if one is not None),
        evrs=tuple(evr_differences(recorded.evrs, replayed.evrs, tolerance)),
        channels=tuple(sorted(channels, key=lambda one: one.first_tick)),
        channels_compared=compared,
        not_compared=tuple(not_compared),
        driven_tick=min(driven, default=None),
    )


def _comparable(topic: str, recorded: TopicSeries, replayed: TopicSeries) -> tuple[list[str], list[str]]:
    """Return the fields that both runs have in equal shape, and sentences about the others."""
    lone = sorted(recorded.fields.keys() ^ replayed.fields.keys())
    both = [name for name in recorded.fields if name in replayed.fields]
    comparable = [name for name in both if recorded.fields[name].shape[1:] == replayed.fields[name].shape[1:]]
    sentences = [f"{channel_name(topic, name)}: only one side has it; not compared" for name in lone]
    sentences += [
        f"{channel_name(topic, name)}: has another shape; not compared"
        for name in both
        if name not in comparable
    ]
    return comparable, sentences


NO_TICKS: Final = np.zeros(0, np.int64)


def _length_difference(topic: str, recorded: Behaviour, replayed: Behaviour) -> LengthDifference | None:
    ours, theirs = (
        side.series[topic].ticks if topic in side.series else NO_TICKS for side in (recorded, replayed)
    )
    lone = np.setxor1d(ours, theirs)
    return LengthDifference(topic, len(ours), len(theirs), int(lone[0])) if lone.size else None


def _evr_length_difference(recorded: Behaviour, replayed: Behaviour) -> LengthDifference | None:
    ours, theirs = recorded.evrs, replayed.evrs
    if len(ours) == len(theirs):
        return None
    first = next(
        min(e.tick for e in pair if e is not None)
        for pair in zip_longest(ours, theirs)
        if None in pair or (pair[0].tick, pair[0].name) != (pair[1].tick, pair[1].name)
    )
    return LengthDifference(EVR_TOPIC, len(ours), len(theirs), first)


def _channel_difference(
    channel: str, name: str, recorded: TopicSeries, replayed: TopicSeries, tolerance: float
) -> ChannelDifference | None:
    """Compare a channel at the ticks that both runs have; None if it is the same."""
    ticks, recorded_rows, replayed_rows = np.intersect1d(recorded.ticks, replayed.ticks, return_indices=True)
    a, b = recorded.fields[name][recorded_rows], replayed.fields[name][replayed_rows]
    if not a.size:
        return None
    shape = a.shape[1:]
    a, b = (side.reshape(len(ticks), -1) for side in (a, b))
    difference = array_difference(a, b, tolerance)
    profile = difference.max(axis=1)
    if not profile.any():
        return None
    first, worst = int(np.flatnonzero(profile)[0]), int(profile.argmax())
    k = int(difference[first].argmax())
    return ChannelDifference(
        channel=channel,
        first_tick=int(ticks[first]),
        first_component=_index(k, shape),
        at_first=(a[first, k].item(), b[first, k].item()),
        ticks=int(np.count_nonzero(profile)),
        compared=len(ticks),
        greatest=float(profile[worst]),
        greatest_tick=int(ticks[worst]),
        component=_index(int(difference[worst].argmax()), shape),
        profile=profile,
    )


def _index(k: int, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.unravel_index(k, shape))
