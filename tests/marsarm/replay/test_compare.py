"""Comparison of two runs: it reports every difference, and nothing else."""

import json
from dataclasses import replace

import numpy as np
import pytest

from marsarm.replaying.compare import MIN_DIFFERENCE, EvrChange, compare_behaviours, evr_differences
from marsarm.replaying.inputs import Behaviour, TopicSeries
from marsarm.telemetry.events import EvrEntry

TICKS = 6


def evr(tick: int, name: str = "Moved", **fields: object) -> EvrEntry:
    return EvrEntry(tick, 1, name, f"{name} {fields}", json.dumps(fields))


BOOTED = evr(0, "Booted")


def behaviour(ticks: int = TICKS, evrs: tuple[EvrEntry, ...] = (BOOTED,), **fields: object) -> Behaviour:
    columns = {name: np.array(values) for name, values in fields.items()}
    return Behaviour(ticks, {"/joint": TopicSeries(np.arange(ticks), columns)}, evrs)


def angles(**changed: float) -> np.ndarray:
    values = np.arange(12.0).reshape(TICKS, 2) / 7
    for place, value in changed.items():
        tick, component = (int(digit) for digit in place.removeprefix("at_").split("_"))
        values[tick, component] = value
    return values


def test_the_first_the_greatest_and_the_count_are_told_apart():
    after = angles(at_1_0=9.0, at_4_1=-90.0, at_5_0=0.0)
    (one,) = compare_behaviours(behaviour(rad=angles()), behaviour(rad=after)).channels
    assert (one.channel, one.first_tick, one.first_component) == ("/joint.rad", 1, (0,))
    assert (one.greatest_tick, one.component) == (4, (1,))
    assert (one.ticks, one.compared) == (3, TICKS)


def test_a_tolerance_is_relative_to_large_numbers_and_not_for_whole_ones():
    far = 1e-12
    assert compare_behaviours(behaviour(rad=angles()), behaviour(rad=angles() + 0.9 * far), far).identical
    assert not compare_behaviours(behaviour(rad=angles()), behaviour(rad=angles() + 2.5 * far), far).identical
    assert compare_behaviours(
        behaviour(Nm=angles() * 1e6), behaviour(Nm=angles() * 1e6 + 1e-9), 1e-9
    ).identical
    assert not compare_behaviours(
        behaviour(n=np.arange(TICKS)), behaviour(n=np.arange(TICKS) + 1), 2.0
    ).identical


LARGE = 2**60


@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
@pytest.mark.parametrize(
    ("was", "now", "apart"),
    [
        (np.int64(LARGE), np.int64(LARGE + 1), 1.0),
        (np.int64(-(2**63)), np.int64(2**63 - 1), 2.0**64),
        (np.int64(-LARGE), np.int64(-LARGE - 1), 1.0),
        (np.uint64(2**64 - 1), np.uint64(2**64 - 2), 1.0),
        (np.int8(-1), np.uint8(255), 256.0),
        (False, True, 1.0),
        (np.nan, 1.0, np.inf),
    ],
)
def test_whole_numbers_are_compared_as_whole_numbers(was, now, apart, tolerance):
    (one,) = compare_behaviours(behaviour(n=[was] * TICKS), behaviour(n=[now] * TICKS), tolerance).channels
    assert (one.ticks, one.greatest) == (TICKS, apart)
    assert one.at_first == pytest.approx((np.asarray(was).item(), np.asarray(now).item()), rel=0, nan_ok=True)
    assert compare_behaviours(behaviour(n=[was] * TICKS), behaviour(n=[was] * TICKS), tolerance).identical


def test_the_sign_of_zero_is_a_difference_bit_for_bit_and_none_within_a_tolerance():
    was, now = behaviour(rad=angles(at_2_0=0.0)), behaviour(rad=angles(at_2_0=-0.0))
    (one,) = compare_behaviours(was, now).channels
    assert (one.first_tick, one.ticks, one.greatest) == (2, 1, MIN_DIFFERENCE)
    assert str(one.at_first) == "(0.0, -0.0)"
    assert compare_behaviours(was, now, 1e-12).identical


@pytest.mark.parametrize(("was", "now"), [(np.inf, 1.0), (1.0, np.inf), (np.inf, -np.inf), (1e308, -1e308)])
def test_no_tolerance_reaches_from_a_number_to_an_infinity(was, now):
    found = compare_behaviours(behaviour(rad=angles(at_2_0=was)), behaviour(rad=angles(at_2_0=now)), 1e-12)
    assert found.channels[0].greatest == np.inf
    assert kinds([evr(3, rad=was)], [evr(3, rad=now)], 1e-12) == [("changed", 3, "Moved")]


def test_a_run_that_ends_early_is_a_difference_of_length():
    found = compare_behaviours(behaviour(rad=angles()), behaviour(4, rad=angles()[:4]))
    assert not found.identical
    assert found.ticks == (6, 4)
    (length,) = found.lengths
    assert (length.topic, length.recorded, length.replayed, length.first_tick) == ("/joint", 6, 4, 4)
    assert found.channels == ()


def test_a_packet_at_another_tick_is_a_difference_of_length():
    was = Behaviour(9, {"/tool": TopicSeries(np.array([0, 4, 8]), {"m": np.zeros(3)})}, (BOOTED,))
    now = Behaviour(9, {"/tool": TopicSeries(np.array([0, 5, 8]), {"m": np.zeros(3)})}, (BOOTED,))
    (length,) = compare_behaviours(was, now).lengths
    assert (length.topic, length.recorded, length.replayed, length.first_tick) == ("/tool", 3, 3, 4)


def test_only_chosen_channels_are_compared_but_events_always():
    found = compare_behaviours(
        behaviour(a=angles(), b=angles()),
        behaviour(a=angles() + 1, b=angles() + 1, evrs=()),
        chosen=lambda topic, name: (topic, name) == ("/joint", "b"),
    )
    assert [one.channel for one in found.channels] == ["/joint.b"]
    assert [one.kind for one in found.evrs] == [EvrChange.MISSING]


def test_channels_of_only_one_run_are_reported():
    found = compare_behaviours(
        behaviour(a=angles(), c=np.zeros(TICKS)), behaviour(b=angles(), c=np.zeros((TICKS, 2)))
    )
    assert found.not_compared == (
        "/joint.a: only one side has it; not compared",
        "/joint.b: only one side has it; not compared",
        "/joint.c: has another shape; not compared",
    )


def kinds(was: list[EvrEntry], now: list[EvrEntry], tolerance: float = 0.0) -> list[tuple]:
    return [(one.kind.value, one.event.tick, one.event.name) for one in evr_differences(was, now, tolerance)]


def test_events_are_missing_added_or_changed():
    was = [BOOTED, evr(3, "Moved", rad=1.0), evr(4, "Stopped")]
    now = [BOOTED, evr(3, "Moved", rad=2.0), evr(5, "Stalled")]
    assert kinds(was, now) == [("changed", 3, "Moved"), ("missing", 4, "Stopped"), ("added", 5, "Stalled")]


def test_the_order_within_a_tick_counts():
    was, now = [evr(3, "A"), evr(3, "B")], [evr(3, "B"), evr(3, "A")]
    assert kinds(was, now) == [("changed", 3, "A"), ("changed", 3, "B")]


def test_within_a_tolerance_fields_are_compared_and_words_are_not():
    was, now = evr(3, rad=[1.0, float("nan")]), evr(3, rad=[1.0 + 1e-13, float("nan")])
    assert was.message != now.message
    assert kinds([was], [now], 1e-12) == []
    assert kinds([was], [replace(now, name="Halted")], 1e-12) == [("changed", 3, "Moved")]
    assert kinds([was], [now]) == [("changed", 3, "Moved")]
    assert kinds([was], [evr(3, rad=[1.1, float("nan")])], 1e-12) == [("changed", 3, "Moved")]
