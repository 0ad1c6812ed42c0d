"""Comparison of the events of two runs: missing, added and changed events."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import zip_longest
from math import isfinite, isnan
from typing import Any

from marsarm.telemetry.events import EvrEntry


class EvrChange(StrEnum):
    """Kind of difference of an event."""

    MISSING = "missing"
    """Recorded, not replayed."""
    ADDED = "added"
    """Replayed, not recorded."""
    CHANGED = "changed"
    """Replayed at another tick, with other fields, or in another order within its tick."""


@dataclass(frozen=True, slots=True)
class EvrDifference:
    """Event that differs; it may be None in one run."""

    kind: EvrChange
    recorded: EvrEntry | None
    replayed: EvrEntry | None

    @property
    def name(self) -> str:
        """Name of the event."""
        return next(one.name for one in (self.recorded, self.replayed) if one is not None)

    @property
    def tick(self) -> int:
        """Earlier one of its two ticks."""
        return min(one.tick for one in (self.recorded, self.replayed) if one is not None)


def evr_differences(
    recorded: Sequence[EvrEntry], replayed: Sequence[EvrEntry], tolerance: float = 0.0
) -> tuple[EvrDifference, ...]:
    """Find the differences between events, in order of ticks.

    Events of equal tick and name are paired in their order. Events without a partner are paired at other
    ticks, first by equal message, then by equal name.
    """
    found: list[EvrDifference] = []
    unpaired: tuple[list[EvrEntry], list[EvrEntry]] = ([], [])
    ours, theirs = _group_by(recorded, "tick"), _group_by(replayed, "tick")
    for tick in sorted({*ours, *theirs}):
        found += _compare_tick(ours.get(tick, []), theirs.get(tick, []), tolerance, unpaired)
    for key in ("message", "name"):
        pairs, unpaired = _pair_evrs(*unpaired, key)
        found += [EvrDifference(EvrChange.CHANGED, one, other) for one, other in pairs]
    found += [EvrDifference(EvrChange.MISSING, one, None) for one in unpaired[0]]
    found += [EvrDifference(EvrChange.ADDED, None, other) for other in unpaired[1]]
    return tuple(sorted(found, key=lambda difference: (difference.tick, difference.name)))


def _pair_evrs(
    recorded: list[EvrEntry], replayed: list[EvrEntry], key: str
) -> tuple[list[tuple[EvrEntry, EvrEntry]], tuple[list[EvrEntry], list[EvrEntry]]]:
    """Pair events of equal message or name in order; return the pairs and the events without a partner."""
    pairs, rest = [], []
    free = _group_by(replayed, key)
    for one in recorded:
        partners = free.get(getattr(one, key))
        if partners:
            pairs.append((one, partners.pop(0)))
        else:
            rest.append(one)
    taken = {id(other) for _, other in pairs}
    return pairs, (rest, [other for other in replayed if id(other) not in taken])


def _compare_tick(
    recorded: list[EvrEntry],
    replayed: list[EvrEntry],
    tolerance: float,
    unpaired: tuple[list[EvrEntry], list[EvrEntry]],
) -> list[EvrDifference]:
    """Compare the events of one tick by name; `unpaired` receives those without a partner."""
    found = []
    recorded_by_name, replayed_by_name = _group_by(recorded, "name"), _group_by(replayed, "name")
    for name in dict.fromkeys((*recorded_by_name, *replayed_by_name)):
        for one, other in zip_longest(recorded_by_name.get(name, []), replayed_by_name.get(name, [])):
            if one is None:
                unpaired[1].append(other)
            elif other is None:
                unpaired[0].append(one)
            elif not _evrs_equal(one, other, tolerance):
                found.append(EvrDifference(EvrChange.CHANGED, one, other))
    names = [[evr.name for evr in side] for side in (recorded, replayed)]
    if names[0] != names[1] and sorted(names[0]) == sorted(names[1]):
        one, other = next((a, b) for a, b in zip(recorded, replayed, strict=True) if a.name != b.name)
        found.append(EvrDifference(EvrChange.CHANGED, one, other))
    return found


def _group_by(evrs: Sequence[EvrEntry], key: str) -> dict[Any, list[EvrEntry]]:
    groups: dict[Any, list[EvrEntry]] = defaultdict(list)
    for evr in evrs:
        groups[getattr(evr, key)].append(evr)
    return groups


def _evrs_equal(one: EvrEntry, other: EvrEntry, tolerance: float) -> bool:
    if tolerance == 0.0:
        return one == other
    # Messages contain rounded numbers, which may differ although the fields agree within the tolerance.
    return one.severity == other.severity and _values_close(one.fields, other.fields, tolerance)


def _values_close(a: Any, b: Any, tolerance: float) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_values_close(a[k], b[k], tolerance) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_values_close(x, y, tolerance) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        near = isfinite(a - b) and abs(a - b) <= tolerance * max(1.0, abs(a))
        return near or a == b or (isnan(a) and isnan(b))
    return bool(a == b)
