"""Readings that cannot be, frozen ones, missed cycles, and another gravity than at the start of a move."""

import pickle
from dataclasses import replace
from itertools import pairwise
from math import atan2

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.config import CYCLE_S
from fsw.dictionary.evrs import CyclesSkipped, ReadingNotUsed
from fsw.dictionary.faults import (
    CycleCountWrong,
    CyclesMissed,
    Fault,
    ReadingImplausible,
    SensorFrozen,
    TiltChanged,
)
from fsw.messages import ActuatorCommand
from fsw.protect import inputs, readings
from tests.fsw.protect.lab import (
    BOUNDS,
    CONFIG,
    MONITORS,
    PARAMS,
    ZERO,
    assert_reports_from,
    below,
    sensors,
)
from tests.fsw.rig import MARS_R_m_s2, alive

QUIET = {
    "resolver_rad": np.zeros(5),
    "current_A": np.zeros(5),
    "winding_C": np.full(5, -40.0),
    "gravity_R_m_s2": MARS_R_m_s2,
    "structure_C": np.full(1, 20.0),
}
BAD = [float("nan"), float("inf"), float("-inf")]


def corrupted(name, place, value):
    values = QUIET[name].copy()
    values[place] = value
    return {name: values}


PERSISTENCE = MONITORS.reading_persistence
ALL, NONE = np.ones(5, bool), np.zeros(5, bool)
STEP_RAD = MONITORS.setpoint_step_factor * CYCLE_S * CONFIG.speed_rad_s
STEP_COUNT = STEP_RAD / CONFIG.rad_per_count
CROSSING_RAD = 6 * 2**0.5 * MONITORS.resolver_noise_rad + 2 * CONFIG.half_backlash_rad
MOST_A = 1.2 * CONFIG.current_limit_A + 6 * MONITORS.current_noise_A
STEPS = {
    "resolver_rad": CROSSING_RAD,
    "winding_C": np.full(5, MONITORS.winding_step_K),
    "gravity_R_m_s2": np.full(3, MONITORS.gravity_step_m_s2),
    "structure_C": np.full(1, MONITORS.structure_step_K),
    "encoder_count": np.floor(PARAMS.motion.settle_error_rad / CONFIG.rad_per_count),
}
PLACES = [
    (name, k) for name, values in ({**QUIET, "encoder_count": ZERO}).items() for k in range(values.size)
]


def drive_to(count=ZERO, rate_rad_s=ZERO):
    return ActuatorCommand(np.array(count, np.int64), rate_rad_s, CONFIG.current_limit_A, NONE, NONE, False)


class Watch:
    """Flight software that only judges readings."""

    def __init__(self, cycles=3):
        self.limits = readings.compute_reading_bounds(PARAMS, CYCLE_S)
        self.state, self.cycle, self.evrs = readings.ReadingState(), 0, ()
        for _ in range(cycles):
            self.judge()

    def judge(self, turning=None, drive=None, cycles=1, **changed):
        """Judge a cycle and return the readings that are used."""
        self.cycle += cycles
        read = {"encoder_count": ZERO, **{name: values + alive(self.cycle) for name, values in QUIET.items()}}
        now = sensors_of(self.cycle, **(read | changed))
        self.state, used, self.evrs = readings.judge(
            self.limits, self.state, now, turning, drive or drive_to()
        )
        return used


def sensors_of(cycle, encoder_count, **changed):
    return replace(sensors(cycle, **changed), encoder_count=np.array(encoder_count, np.int64))


def with_number(name, place, value):
    """Readings in which one number is this."""
    values = np.zeros(5, np.int64) if name == "encoder_count" else QUIET[name].copy()
    values[place] = value
    return {name: values}


def numbers(used, name):
    return np.atleast_1d(getattr(used, name))


def name_of(name, place):
    return name if name in ("gravity_R_m_s2", "structure_C") else f"{name}[{place}]"


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_a_number_within_its_bound_is_used_and_one_beyond_it_is_not_and_told_once(name, place):
    if name == "current_A":
        near, far = MOST_A[place] * (1 - 1e-9), MOST_A[place] * (1 + 1e-9)
    else:
        step = STEPS[name][place]
        start = 0.0 if name == "encoder_count" else QUIET[name][place]
        near, far = start + step * (1 - 1e-9), start + step * (1 + 1e-9) + 1e-9
        near, far = (step, step + 1) if name == "encoder_count" else (near, far)
    watch = Watch()
    before = watch.judge()
    assert numbers(watch.judge(**with_number(name, place, near)), name)[place] == near
    assert watch.evrs == ()
    watch = Watch(4)
    used = watch.judge(**with_number(name, place, far))
    np.testing.assert_allclose(numbers(used, name), numbers(before, name), atol=1e-11)
    (evr,) = watch.evrs
    assert isinstance(evr, ReadingNotUsed)
    assert evr.sensor.startswith(name)
    watch.judge()
    assert watch.evrs == ()
    assert watch.state.is_plain


WILD = [*BAD, 1e300, -1e300, 1.7e308, 1e9]


@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize(("name", "place"), PLACES)
def test_a_wild_number_is_a_fault_when_it_lasts_and_never_sooner(name, place, wild):
    watch = Watch()
    before = watch.judge()
    if name == "encoder_count":
        wild = np.iinfo(np.int64).max if wild > 0 else np.iinfo(np.int64).min
    for cycle in range(1, 2 * PERSISTENCE):
        used = watch.judge(**with_number(name, place, wild))
        for field in (*QUIET, "encoder_count"):
            np.testing.assert_allclose(numbers(used, field), numbers(before, field), atol=1e-11)
        kinds = [type(evr) for evr in watch.evrs]
        assert kinds == [ReadingNotUsed] * (cycle == 1) + [ReadingImplausible] * (cycle >= PERSISTENCE)
        for evr in watch.evrs:
            assert evr.sensor == name_of(name, place)
            assert len(evr.message) < 120
            assert np.isfinite([evr.lowest, evr.highest]).all()
    watch.judge()
    assert watch.evrs == ()


@given(st.sampled_from(PLACES), st.floats(), st.integers(1, PERSISTENCE - 1))
def test_whatever_a_number_reads_what_is_used_stays_near_and_the_right_one_after_it_is_never_wild(
    where, value, times
):
    name, place = where
    watch = Watch()
    before = watch.judge()
    if name == "encoder_count":
        most = np.iinfo(np.int64)
        value = int(np.clip(value, -1e18, 1e18)) if value == value else most.min
    for _ in range(times):
        used = watch.judge(**with_number(name, place, value))
        away = np.abs(numbers(used, name) - numbers(before, name))
        bound = 2 * MOST_A if name == "current_A" else STEPS[name]
        assert (away <= bound * (1 + 1e-9) + 1e-9).all()
    watch.judge()
    assert watch.evrs == ()
    assert watch.state.is_plain


def test_wrong_numbers_of_one_sensor_are_one_event_and_those_of_others_are_others():
    watch = Watch()
    watch.judge(encoder_count=np.array([1000, 0, 1000, 0, 0]), current_A=np.full(5, np.nan))
    assert [evr.sensor for evr in watch.evrs] == ["current_A[0,1,2,3,4]", "encoder_count[0,2]"]


@pytest.mark.parametrize("joint", range(5))
def test_a_motor_may_turn_to_its_set_point_and_beyond_it_and_others_stand(joint):
    this = np.arange(5) == joint
    for goal, most, least in (
        (300, 600 + 2 * STEP_COUNT[joint], -300 - 2 * STEP_COUNT[joint]),
        (0, 2 * STEP_COUNT[joint], -2 * STEP_COUNT[joint]),  # a step since each of the last two readings
    ):
        for count, said in ((most - 1, 0), (most + 1, 1), (least + 1, 0), (least - 1, 1)):
            watch = Watch()
            watch.judge(ALL, drive_to(goal * this), encoder_count=np.round(count) * this)
            assert len(watch.evrs) == said, (goal, count)
    watch = Watch()
    watch.judge(~this, drive_to(300 * this), encoder_count=100 * this)
    assert len(watch.evrs) == 1


def test_a_motor_whose_encoder_is_not_plausible_goes_on_as_it_turned_at_its_commanded_rate_at_most():
    step = 80
    for commanded, expected in ((80, 80), (50, 50), (200, 80), (0, 0), (-80, 0)):
        watch, at = Watch(), 0
        rate = commanded * CONFIG.rad_per_count / CYCLE_S
        for _ in range(5):
            at += step
            watch.judge(ALL, drive_to(np.full(5, at), rate), encoder_count=np.full(5, at))
        for cycle in range(1, PERSISTENCE):
            used = watch.judge(ALL, drive_to(np.full(5, at), rate), encoder_count=np.full(5, 10**15))
            np.testing.assert_array_equal(used.encoder_count, at + cycle * expected)
        later = watch.judge(
            ALL, drive_to(np.full(5, at), rate), encoder_count=np.full(5, at + PERSISTENCE * step)
        )
        assert watch.evrs == ()
        np.testing.assert_array_equal(later.encoder_count, at + PERSISTENCE * step)


@pytest.mark.parametrize("missed", range(1, MONITORS.missed_cycles + 1))
def test_a_few_missed_cycles_are_reported_and_motors_may_have_turned_in_them(missed):
    watch = Watch()
    count = np.floor((1 + missed) * STEP_COUNT)
    watch.judge(ALL, cycles=1 + missed, encoder_count=count)
    assert watch.evrs == (CyclesSkipped(missed),)
    watch = Watch()
    watch.judge(ALL, cycles=1 + missed, encoder_count=count + STEP_COUNT + 2)
    assert [type(evr) for evr in watch.evrs] == [CyclesSkipped, ReadingNotUsed]


@pytest.mark.parametrize("missed", [MONITORS.missed_cycles + 1, 100, 10**18])
def test_more_missed_cycles_are_a_fault_once_the_next_count_agrees(missed):
    watch = Watch()
    watch.judge(cycles=1 + missed)
    assert [(type(evr), evr.sensor) for evr in watch.evrs] == [(ReadingNotUsed, "cycle")]
    watch.judge()
    assert watch.evrs == (CyclesMissed(missed, MONITORS.missed_cycles),)
    watch.judge()
    assert watch.evrs == ()


@pytest.mark.parametrize("wild", [-(2**63), -1, 10**6, 2**63 - 1])
def test_one_wild_cycle_count_is_told_and_forgotten(wild):
    watch = Watch()
    last = watch.cycle
    watch.cycle = wild - 1
    watch.judge()
    assert [type(evr) for evr in watch.evrs] == [ReadingNotUsed]
    watch.cycle = last + 1
    for _ in range(2 * PERSISTENCE):
        watch.judge()
        assert watch.evrs == ()


def test_a_count_that_stands_or_goes_back_is_a_fault():
    watch = Watch()
    found = []
    for _ in range(PERSISTENCE):
        watch.judge(cycles=0)
        found += watch.evrs
    assert [type(evr) for evr in found] == [ReadingNotUsed, CycleCountWrong]
    watch = Watch()
    watch.judge(cycles=-50)
    watch.judge()
    assert [type(evr) for evr in watch.evrs] == [CycleCountWrong]


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_nothing_begins_with_a_wild_reading(name, place):
    wild = {"resolver_rad": 1.0, "current_A": 1.0, "encoder_count": 1000.0}.get(name, -30.0)
    wild = (
        -MARS_R_m_s2[2]
        if name == "gravity_R_m_s2" and place == 2
        else 2.0
        if name == "gravity_R_m_s2"
        else wild
    )
    watch = Watch(0)
    watch.judge(**with_number(name, place, wild))
    assert watch.state.begins
    assert not watch.state.history.is_confirmed
    watch.judge()
    assert watch.state.begins is (name != "current_A")
    assert len(watch.evrs) == (name != "current_A")
    watch.judge()
    assert not watch.state.begins
    assert watch.state.history.is_confirmed
    for value in BAD if name != "encoder_count" else [2**53]:
        watch = Watch(0)
        for cycle in range(1, PERSISTENCE + 2):
            watch.judge(**with_number(name, place, value))
            assert not watch.state.usable
            faults = [evr for evr in watch.evrs if isinstance(evr, Fault)]
            assert len(faults) == (cycle >= PERSISTENCE)
        watch.judge()
        assert watch.state.begins


def test_first_readings_that_the_next_contradict_are_told_and_the_present_ones_are_not():
    watch = Watch(0)
    watch.judge(**with_number("winding_C", 2, -30.0))
    watch.judge()
    (evr,) = watch.evrs
    assert (evr.sensor, evr.value) == ("winding_C[2]", -30.0)
    assert evr.lowest <= -40.0 <= evr.highest < -30.0


@pytest.mark.parametrize("wild", [1e300, 30.0])
def test_a_wild_reading_after_missed_cycles_is_one_reading(wild):
    """Cycles that were missed have no readings that could be wrong."""
    watch = Watch()
    for _ in range(2):
        watch.judge(cycles=MONITORS.missed_cycles + 1, **with_number("winding_C", 0, wild))
        assert not any(isinstance(evr, ReadingImplausible) for evr in watch.evrs)


def test_a_state_that_was_written_and_read_again_goes_on_alike():
    watch, other = Watch(), Watch()
    other.state = pickle.loads(pickle.dumps(other.state))
    for one in (watch, other):
        one.judge(**with_number("winding_C", 0, 1e300))
    assert watch.evrs == other.evrs
    assert watch.state.used == other.state.used


def test_a_move_that_began_on_first_readings_is_ended_where_the_next_contradict_them():
    watch = Watch(0)
    watch.judge(encoder_count=np.full(5, 1000))
    watch.judge(ALL, drive_to(np.full(5, 1000)))
    assert [type(evr) for evr in watch.evrs] == [ReadingImplausible]


def test_the_ground_may_have_a_number_used_that_stays_but_not_one_out_of_range():
    watch = Watch()
    for _ in range(PERSISTENCE):
        watch.judge(encoder_count=np.array([0, 1000, 0, 0, 0]))
    state, jumps = readings.accept_present(watch.limits, watch.state)
    assert jumps == ((1, 1000),)
    assert state.is_plain
    watch.state = state
    used = watch.judge(encoder_count=np.array([0, 1000, 0, 0, 0]))
    assert watch.evrs == ()
    assert used.encoder_count[1] == 1000
    watch.judge(current_A=np.full(5, np.nan))
    assert readings.accept_present(watch.limits, watch.state) == "out of range: current_A"


def test_what_is_told_again_was_plausible_for_a_persistence():
    watch, told = Watch(), 0
    for cycle in range(3 * PERSISTENCE):
        watch.judge(**(with_number("winding_C", 3, 100.0) if cycle % 3 == 0 else {}))
        told += len(watch.evrs)
    assert told == 1
    for _ in range(PERSISTENCE + 1):
        watch.judge()
    watch.judge(**with_number("winding_C", 3, 100.0))
    assert len(watch.evrs) == 1
    channels = readings.reading_channels(7, watch.state)
    np.testing.assert_array_equal(channels.winding_valid, np.arange(5) != 3)
    np.testing.assert_array_equal(channels.winding_unused_count, (PERSISTENCE + 1) * (np.arange(5) == 3))
    assert channels.gravity_valid
    assert channels.gravity_unused_count == 0


BEFORE = tuple(float(k) for k in range(14))
LATER = tuple(x + 0.5 for x in BEFORE)
SENSOR_AT = ["resolver_rad"] * 5 + ["current_A"] * 5 + ["gravity_R_m_s2"] * 3 + ["structure_C"]


def test_readings_that_change_are_alive_however_long_they_stood_and_frozen_sensors_are_named_once_each():
    assert inputs.check_frozen(BOUNDS, (10_000,) * 14, BEFORE, LATER) == ((0,) * 14, ())
    bound = MONITORS.frozen_persistence
    stood = (bound - 1,) * 5 + (bound - 2,) * 5 + (bound + 3,) * 3 + (0,)
    _, found = inputs.check_frozen(BOUNDS, stood, BEFORE, BEFORE)
    assert found == (SensorFrozen("resolver_rad", bound), SensorFrozen("gravity_R_m_s2", bound + 4))
    counts = inputs.NONE_UNCHANGED
    for before, now in pairwise([BEFORE, BEFORE, BEFORE, LATER, LATER]):
        counts, _ = inputs.check_frozen(BOUNDS, counts, before, now)
    assert counts == (1,) * 14


@pytest.mark.parametrize("place", range(14))
def test_a_number_that_stays_the_same_is_counted_by_itself_and_named_from_its_persistence_on(place):
    now = tuple(
        x if k == place else x + 0.5 * (-1) ** k for k, x in enumerate(BEFORE)
    )  # others rise and fall
    bound = MONITORS.frozen_persistence
    for stood in (0, 1, bound - 2):
        counts, found = inputs.check_frozen(BOUNDS, (stood,) * 14, BEFORE, now)
        assert counts == tuple(stood + 1 if k == place else 0 for k in range(14))
        assert found == ()
    for stood in (bound - 1, bound, 5 * bound):
        counts, found = inputs.check_frozen(BOUNDS, (stood,) * 14, BEFORE, now)
        assert counts[place] == stood + 1
        assert found == (SensorFrozen(SENSOR_AT[place], stood + 1),)


def test_as_many_readings_are_compared_as_there_are_and_none_is_left_out():
    with pytest.raises(ValueError, match="shorter"):
        inputs.check_frozen(BOUNDS, (0,) * 13, BEFORE, BEFORE)
    with pytest.raises(ValueError, match="shorter"):
        inputs.check_frozen(BOUNDS, (10_000,) * 13, BEFORE[:13], BEFORE[:13])


directions = st.tuples(st.floats(-1, 1), st.floats(0, 2 * np.pi)).map(
    lambda zf: np.array(
        [np.sqrt(1 - zf[0] ** 2) * np.cos(zf[1]), np.sqrt(1 - zf[0] ** 2) * np.sin(zf[1]), zf[0]]
    )
)


def turned(direction, angle_rad, about_rad):
    """A unit vector this angle away from a direction, on any side of it."""
    one = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    one /= np.linalg.norm(one)
    other = np.cross(direction, one)
    sideways = np.cos(about_rad) * one + np.sin(about_rad) * other
    return np.cos(angle_rad) * direction + np.sin(angle_rad) * sideways


@given(directions, st.floats(0, 2 * np.pi), st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_gravity_that_turns_by_more_than_its_bound_is_reported_whatever_its_direction_and_size(
    direction, about_rad, planned, read
):
    bound = MONITORS.tilt_rad
    for share, said in ((0.0, False), (0.999, False), (1.001, True), (1.5, True), (20.0, True)):
        now = read * turned(direction, share * bound, about_rad)
        count, found = inputs.check_tilt(BOUNDS, 1000, planned * direction, now)
        assert count == (1001 if said else 0)
        assert [evr.turned_rad for evr in found] == pytest.approx([share * bound] if said else [], rel=1e-9)


def test_a_turn_is_reported_from_its_persistence_on_even_to_the_opposite():
    bound = MONITORS.tilt_rad
    planned, read = np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -3.0])
    event = TiltChanged(np.pi, bound)
    assert_reports_from(
        MONITORS.tilt_persistence, lambda count: inputs.check_tilt(BOUNDS, count, planned, read), event
    )


@pytest.mark.parametrize("angle_rad", np.linspace(0.01, 0.5, 20))
def test_a_turn_of_exactly_the_bound_is_none(angle_rad):
    planned, read = np.array([1.0, 0.0, 0.0]), np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    exactly = atan2(read[1], read[0])
    for bound, said in ((exactly, False), (below(exactly), True)):
        bounds = replace(BOUNDS, monitors=replace(MONITORS, tilt_rad=bound))
        assert bool(inputs.check_tilt(bounds, 0, planned, read)[0]) is said
