"""Readings that are no numbers, frozen, too few, or of another gravity than at the start of a move."""

from dataclasses import replace
from itertools import pairwise
from math import atan2

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.dictionary.evrs import CyclesSkipped
from fsw.dictionary.faults import (
    CycleCountWrong,
    CyclesMissed,
    GravityImplausible,
    SensorFrozen,
    SensorNotFinite,
    StructureTemperatureImplausible,
    TiltChanged,
)
from fsw.protect import inputs
from tests.fsw.protect.lab import BOUNDS, MONITORS, above, assert_reports_from, below, sensors
from tests.fsw.rig import MARS_R_m_s2

QUIET = {
    "resolver_rad": np.zeros(5),
    "current_A": np.zeros(5),
    "winding_C": np.full(5, -40.0),
    "gravity_R_m_s2": MARS_R_m_s2,
    "structure_C": np.full(1, 20.0),
}
BOUNDED = ("gravity_R_m_s2", "structure_C")
BAD = [float("nan"), float("inf"), float("-inf")]
IMPLAUSIBLE = (SensorNotFinite, GravityImplausible, StructureTemperatureImplausible)
PLACES = [(name, k) for name, values in QUIET.items() for k in range(values.size)]
MIN_m_s2, MAX_m_s2 = MONITORS.gravity_min_m_s2, MONITORS.gravity_max_m_s2
MIN_C, MAX_C = MONITORS.structure_min_C, MONITORS.structure_max_C


def corrupted(name, place, value):
    values = QUIET[name].copy()
    values[place] = value
    return {name: values}


def found_in(**readings):
    return inputs.check_readings(BOUNDS, sensors(**readings))


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize(("name", "place"), PLACES)
def test_one_element_that_is_no_number_is_named_by_its_sensor(name, place, value):
    assert found_in(**corrupted(name, place, value)) == (SensorNotFinite(name),)


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_finite_readings_of_any_size_are_finite(name, place):
    sizes = (-20.0, -1.0, 1.0, 20.0) if name in BOUNDED else (0.0, -1e6, 1e6, 5e-324)
    for value in sizes:
        values = np.zeros_like(QUIET[name])
        values[place] = value
        assert found_in(**{name: values}) == ()


def test_all_sensors_that_are_not_finite_are_named_and_infinities_do_not_cancel():
    bad = {name: np.array([*BAD[1:], *values[2:]])[: values.size] for name, values in QUIET.items()}
    assert found_in(**bad) == tuple(SensorNotFinite(name) for name in QUIET)


def test_wild_but_finite_readings_are_judged_without_a_warning():
    assert found_in(resolver_rad=np.full(5, 5e307), current_A=np.full(5, 8e307)) == ()
    for name in QUIET:
        found = found_in(**corrupted(name, 0, 1e200))
        assert all(isinstance(evr, IMPLAUSIBLE) for evr in found)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (0.6, 0, -0.8), (-0.36, 0.48, 0.8)])
def test_gravity_is_implausible_outside_its_bounds_in_any_direction(direction):
    for pull_m_s2, said in (
        (0.0, True),
        (5e-324, True),
        (0.9999 * MIN_m_s2, True),
        (1.0001 * MIN_m_s2, False),
        (3.711, False),
        (0.9999 * MAX_m_s2, False),
        (1.0001 * MAX_m_s2, True),
        (1e3 * MAX_m_s2, True),
    ):
        found = found_in(gravity_R_m_s2=pull_m_s2 * np.array(direction))
        assert bool(found) is said
        if said:
            (evr,) = found
            assert evr == GravityImplausible(evr.gravity_m_s2, MIN_m_s2, MAX_m_s2)
            assert evr.gravity_m_s2 == pytest.approx(pull_m_s2, rel=1e-12)


def test_gravity_and_structure_at_their_bounds_are_plausible_and_the_next_number_is_not():
    for bound, beyond in ((MIN_m_s2, below), (MAX_m_s2, above)):
        assert found_in(gravity_R_m_s2=[0.0, 0.0, bound]) == ()
        assert found_in(gravity_R_m_s2=[0.0, 0.0, beyond(bound)]) != ()
    for bound, beyond in ((MIN_C, below), (MAX_C, above)):
        wrong = StructureTemperatureImplausible(beyond(bound), MIN_C, MAX_C)
        assert found_in(structure_C=bound) == ()
        assert found_in(structure_C=beyond(bound)) == (wrong,)


def test_every_number_that_has_noise_is_looked_at_by_itself_and_no_other():
    quiet = inputs.noisy_readings(sensors(**QUIET))
    assert len(quiet) == len(inputs.NONE_UNCHANGED)
    noisy = [place for place in PLACES if place[0] != "winding_C"]
    for k, place in enumerate(noisy):
        changed = inputs.noisy_readings(sensors(**{**QUIET, **corrupted(*place, 7.0)}))
        assert [a != b for a, b in zip(quiet, changed, strict=True)] == [k == j for j in range(len(noisy))]
    assert inputs.noisy_readings(sensors(**{**QUIET, "winding_C": np.ones(5)})) == quiet


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


def test_cycles_are_counted_from_the_second_call_on_and_a_count_that_repeats_or_goes_back_is_a_fault():
    for before, now in ((None, 12345), (7, 8), (-2, -1)):
        assert inputs.check_cycle_count(BOUNDS, before, now) == ()
    for now in (7, 6, -43, -(10**9)):
        assert inputs.check_cycle_count(BOUNDS, 7, now) == (CycleCountWrong(now, 7),)


@pytest.mark.parametrize("before", [-5, 0, 1000])
def test_a_few_missed_cycles_are_reported_and_more_are_a_fault(before):
    most = MONITORS.missed_cycles
    for missed in range(1, most + 1):
        assert inputs.check_cycle_count(BOUNDS, before, before + 1 + missed) == (CyclesSkipped(missed),)
    for missed in (most + 1, most + 100):
        assert inputs.check_cycle_count(BOUNDS, before, before + 1 + missed) == (CyclesMissed(missed, most),)


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
