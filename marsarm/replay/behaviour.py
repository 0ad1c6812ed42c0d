"""Outputs of flight software in a run: packets by topic, and events."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.messages import Outputs
from marsarm.telemetry.events import EvrEntry, evr_entry
from marsarm.telemetry.read import Log
from marsarm.telemetry.topics import PACKET_TOPICS, Topic

OUTPUTS_PREFIX: Final = "outputs."
OUTPUT_TOPICS: Final[tuple[Topic, ...]] = tuple(
    topic for topic, _ in PACKET_TOPICS if topic.path.startswith(OUTPUTS_PREFIX)
)


@dataclass(frozen=True, slots=True, eq=False)
class TopicSeries:
    """Packets of one topic."""

    ticks: NDArray[np.int64]
    """Tick of each packet, rising, shape (n,)."""
    fields: Mapping[str, NDArray[Any]]
    """Values by field, shape (n, ...)."""


@dataclass(frozen=True, slots=True, eq=False)
class Behaviour:
    """Outputs of flight software in a run; topics without packets are absent."""

    ticks: int
    """Number of cycles, from tick 0."""
    series: Mapping[str, TopicSeries]
    evrs: tuple[EvrEntry, ...]


def behaviour_from_log(log: Log, ticks: int) -> Behaviour:
    """Return the outputs in a log, up to a number of ticks."""
    series = {}
    for topic in OUTPUT_TOPICS:
        if topic.name in log.packets:
            end = int(np.searchsorted(log.ticks(topic.name), ticks))
            packets = log[topic.name][:end]
            names = [name for name in topic.field_names if name in (packets.dtype.names or ())]
            series[topic.name] = TopicSeries(
                log.ticks(topic.name)[:end], {name: packets[name] for name in names}
            )
    evrs = tuple(evr for evr in log.evrs if evr.tick < ticks)
    return Behaviour(ticks, series, evrs)


def behaviour_from_outputs(outputs: Sequence[Outputs]) -> Behaviour:
    """Return the outputs of a run, given for each cycle from tick 0."""
    series = {}
    for topic in OUTPUT_TOPICS:
        packet_of = attrgetter(topic.path.removeprefix(OUTPUTS_PREFIX))
        packets = [
            (tick, packet) for tick, out in enumerate(outputs) if (packet := packet_of(out)) is not None
        ]
        if packets:
            ticks = np.array([tick for tick, _ in packets], np.int64)
            series[topic.name] = TopicSeries(
                ticks, _columns(topic.field_names, [packet for _, packet in packets])
            )
    evrs = tuple(evr_entry(tick, evr) for tick, out in enumerate(outputs) for evr in out.evrs)
    return Behaviour(len(outputs), series, evrs)


def _columns(names: Iterable[str], packets: list[Any]) -> dict[str, NDArray[Any]]:
    return {name: np.array([getattr(packet, name) for packet in packets]) for name in names}
