"""One behaviour against another: lengths, events and channels, and where they first part."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.replay.behaviour import Behaviour, TopicSeries
from ground.replay.compare_evrs import EvrDifference, evr_differences
from ground.telemetry.format import EVR_TOPIC
from ground.telemetry.topics import channel_name

MIN_DIFFERENCE: Final = np.finfo(np.float64).smallest_subnormal.item()
"""How far apart 0.0 and -0.0 are: they are not the same."""


def array_difference(a: NDArray[Any], b: NDArray[Any], tolerance: float) -> NDArray[np.float64]:
    """How far apart numbers are, shape of both; 0 where they are the same, and nowhere else.

    Infinite where only one is a number, LEAST where no number says by how much, as of 0.0 and -0.0.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        off = _distance(a, b)
    if {a.dtype.kind, b.dtype.kind} == {"f"}:
        same = _floats_equal(a, b, off, tolerance)
    else:
        same = _exactly_equal(a, b)
    return np.where(same, 0.0, np.where(np.isnan(off), np.inf, np.maximum(off, MIN_DIFFERENCE)))


def _distance(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """Of whole numbers, that of the integers: as floats, large neighbours are one number."""
    if not (_is_integer(a) and _is_integer(b)):
        return np.abs(a.astype(np.float64) - b.astype(np.float64))
    c, d = a.astype(np.uint64), b.astype(np.uint64)  # negative ones wrap, and so does their difference
    return np.where(a > b, c - d, d - c).astype(np.float64)


def _floats_equal(
    a: NDArray[Any], b: NDArray[Any], off: NDArray[np.float64], tolerance: float
) -> NDArray[np.bool_]:
    a, b = a.astype(np.float64), b.astype(np.float64)
    both_nan = np.isnan(a) & np.isnan(b)
    if tolerance == 0.0:
        same: NDArray[np.bool_] = a.view(np.int64) == b.view(np.int64)
    else:
        same = (a == b) | (np.isfinite(off) & (off <= tolerance * np.maximum(1.0, np.abs(a))))
    return np.asarray(same | both_nan)


def _exactly_equal(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Numbers of any two kinds; Python compares an int with a float without rounding it."""
    if _is_integer(a) and _is_integer(b):
        return np.asarray(a == b)
    return np.asarray(a.astype(object) == b.astype(object), np.bool_)


def _is_integer(numbers: NDArray[Any]) -> bool:
    return numbers.dtype.kind in "biu"


BEFORE, AFTER = 8, 24
"""Ticks of the topic that are kept before and from the first difference on."""

ChannelFilter = Callable[[str, str], bool]
"""Whether to compare a field of a topic."""
Number = float | int | bool


@dataclass(frozen=True, slots=True)
class LengthDifference:
    """A topic with more messages on one side."""

    topic: str
    recorded: int
    replayed: int
    first_tick: int
    """The first tick at which only one side has a message."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDifference:
    """A channel with other values; an array is one channel, judged component by component."""

    channel: str
    first_tick: int
    first_component: tuple[int, ...]
    """Of an array: the one that differs most at the first tick."""
    at_first: tuple[Number, Number]
    """Its values there, recorded and replayed."""
    recorded: NDArray[Any]
    """Its values around there."""
    replayed: NDArray[Any]
    ticks: int
    """At how many ticks the channel differs."""
    compared: int
    """At how many it was compared."""
    greatest: float
    """The greatest difference; as of `apart`."""
    greatest_tick: int
    component: tuple[int, ...]
    """Of an array: the one with the greatest difference."""
    profile: NDArray[np.float64]
    """The greatest difference of any component at each tick compared, shape (compared,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """What is not the same; nothing of it if all is."""

    tolerance: float
    ticks: tuple[int, int]
    """Recorded and replayed."""
    lengths: tuple[LengthDifference, ...]
    evrs: tuple[EvrDifference, ...]
    channels: tuple[ChannelDifference, ...]
    channels_compared: int
    evrs_compared: bool
    not_compared: tuple[str, ...]
    """Sentences about what only one side can tell."""

    @property
    def identical(self) -> bool:
        """Whether all that was compared is the same."""
        same_length = self.ticks[0] == self.ticks[1]
        return same_length and not (self.lengths or self.evrs or self.channels)

    @property
    def nothing_compared(self) -> bool:
        """Whether there was nothing on both sides that could have differed."""
        return not (self.channels_compared or self.evrs_compared)


def every_channel(topic: str, field: str) -> bool:
    """Choose all."""
    return True


def compare_behaviours(
    recorded: Behaviour, replayed: Behaviour, tolerance: float = 0.0, chosen: ChannelFilter = every_channel
) -> Differences:
    """What is not the same; NaN is the same as NaN.

    `tolerance` is relative to numbers beyond 1, absolute below; 0 is bit for bit. Whole numbers and flags
    are to be the same at any tolerance.
    Flight software always says that it is up: without any event, a log is of something else, and what it has
    not got is not compared.
    """
    foreign = not recorded.evrs and recorded.ticks > 0
    lacking = [topic for topic in replayed.series if topic not in recorded.series] if foreign else []
    topics = [t for t in dict.fromkeys((*recorded.series, *replayed.series)) if t not in lacking]
    untold = [
        f"{topic}: not recorded; not compared" for topic in (*lacking, *([EVR_TOPIC] if foreign else []))
    ]
    lengths = [_length_difference(topic, recorded, replayed) for topic in topics]
    channels, compared = [], 0
    for topic in topics:
        ours, theirs = recorded.series.get(topic), replayed.series.get(topic)
        if ours is None or theirs is None:
            continue
        comparable, sentences = _comparable(topic, ours, theirs)
        untold += sentences
        for name in (name for name in comparable if chosen(topic, name)):
            compared += 1
            channels.append(_channel_difference(channel_name(topic, name), name, ours, theirs, tolerance))
    return Differences(
        tolerance=tolerance,
        ticks=(recorded.ticks, replayed.ticks),
        lengths=tuple(
            one
            for one in (*lengths, None if foreign else _evr_length_difference(recorded, replayed))
            if one is not None
        ),
        evrs=() if foreign else evr_differences(recorded.evrs, replayed.evrs, tolerance),
        channels=tuple(one for one in channels if one is not None),
        channels_compared=compared,
        evrs_compared=not foreign,
        not_compared=tuple(untold),
    )


def _comparable(topic: str, ours: TopicSeries, theirs: TopicSeries) -> tuple[list[str], list[str]]:
    """The fields that both sides have, in one shape; and sentences about the others."""
    lone = sorted(ours.fields.keys() ^ theirs.fields.keys())
    both = [name for name in ours.fields if name in theirs.fields]
    fit = [name for name in both if ours.fields[name].shape[1:] == theirs.fields[name].shape[1:]]
    sentences = [f"{channel_name(topic, name)}: only one side has it; not compared" for name in lone]
    sentences += [
        f"{channel_name(topic, name)}: has another shape; not compared" for name in both if name not in fit
    ]
    return fit, sentences


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
    channel: str, name: str, ours: TopicSeries, theirs: TopicSeries, tolerance: float
) -> ChannelDifference | None:
    """Where a channel differs at the ticks that both sides have; None where nowhere."""
    ticks, mine, yours = np.intersect1d(ours.ticks, theirs.ticks, return_indices=True)
    a, b = ours.fields[name][mine], theirs.fields[name][yours]
    if not a.size:
        return None
    shape = a.shape[1:]
    a, b = (side.reshape(len(ticks), -1) for side in (a, b))
    off = array_difference(a, b, tolerance)
    profile = off.max(axis=1)
    if not profile.any():
        return None
    first, worst = int(np.flatnonzero(profile)[0]), int(profile.argmax())
    k, window = int(off[first].argmax()), slice(max(0, first - BEFORE), first + AFTER)
    return ChannelDifference(
        channel=channel,
        first_tick=int(ticks[first]),
        first_component=_index(k, shape),
        at_first=(a[first, k].item(), b[first, k].item()),
        recorded=a[window, k],
        replayed=b[window, k],
        ticks=int(np.count_nonzero(profile)),
        compared=len(ticks),
        greatest=float(profile[worst]),
        greatest_tick=int(ticks[worst]),
        component=_index(int(off[worst].argmax()), shape),
        profile=profile,
    )


def _index(k: int, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.unravel_index(k, shape))
