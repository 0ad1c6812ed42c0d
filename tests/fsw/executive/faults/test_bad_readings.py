"""A reading that is no number stops the arm at once; nothing non-finite ever reaches a motor."""

from dataclasses import fields

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault, MoveJoints, Retract, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAborted, CommandRefused, FaultResponse, ModeChanged
from fsw.dictionary.faults import GravityImplausible, SensorNotFinite
from fsw.messages import Sensors
from tests.fsw.rig import MARS_R_m_s2, Rig, config_of, facing, floats, quiet_sensors

CONFIG = config_of()
START = facing(CONFIG, "apxs")
QUIET = {
    "resolver_rad": np.zeros(5),
    "current_A": np.zeros(5),
    "winding_C": np.full(5, -40.0),
    "gravity_R_m_s2": MARS_R_m_s2,
    "structure_C": np.full(1, 20.0),
}
BAD = [float("nan"), float("inf"), float("-inf")]
PLACES = [(name, k) for name, values in QUIET.items() for k in range(values.size)]
MOVES = {
    "joints": lambda rig: MoveJoints(floats(START + 0.05)),
    "guarded": lambda rig: rig.touch("apxs", 0.1),
    "retract": lambda rig: Retract("apxs", 0.1),
}


def corrupted(name, place, value):
    values = QUIET[name].copy()
    values[place] = value
    return {name: values}


def moving(kind="joints"):
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(MOVES[kind](rig))
    return rig


def finite(drive):
    return bool(np.isfinite(drive.setpoint_rate_rad_s).all() and np.isfinite(drive.current_limit_A).all())


def test_every_field_that_can_be_no_number_is_tested_here():
    quiet = quiet_sensors(np.zeros(5))
    analog = {f.name for f in fields(Sensors) if np.asarray(getattr(quiet, f.name)).dtype.kind == "f"}
    assert analog == set(QUIET)


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize(("name", "place"), PLACES)
def test_one_bad_element_stops_the_arm_in_the_same_cycle(name, place, value):
    rig = moving()
    follow = rig.outputs.drive.setpoint_count
    rig.evrs.clear()
    out = rig.cycle(**corrupted(name, place, value))
    assert out.evrs == (
        SensorNotFinite(name),
        FaultResponse("BRAKE_AND_REFUSE"),
        ModeChanged(Mode.FREE_SPACE, Mode.FAULTED),
    )
    assert not out.drive.brake_release.any()
    assert not out.drive.setpoint_rate_rad_s.any()
    assert finite(out.drive)
    # held where the motors were last seen: no farther than the cycle just passed
    step = np.ceil(CONFIG.speed_rad_s / 64 / CONFIG.rad_per_count)
    assert (np.abs(out.drive.setpoint_count - follow) <= step).all()


@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize("value", BAD)
def test_the_set_point_is_frozen_from_the_bad_reading_on(kind, value):
    rig = moving(kind)
    held = rig.cycle(**corrupted("current_A", 2, value)).drive.setpoint_count
    for k in range(60):
        out = rig.cycle(**(corrupted("winding_C", k % 5, value) if k % 3 == 0 else {}))
        np.testing.assert_array_equal(out.drive.setpoint_count, held)
        assert not out.drive.setpoint_rate_rad_s.any()
        assert not out.drive.brake_release.any()
        assert finite(out.drive)
    assert not out.drive.power_on.any()
    assert rig.state.mode is Mode.FAULTED


@pytest.mark.parametrize("kind", MOVES)
def test_the_aborted_move_is_reported_and_later_moves_are_refused_until_cleared(kind):
    rig = moving(kind)
    name = rig.state.move.plan.command
    rig.evrs.clear()
    rig.cycle(**corrupted("resolver_rad", 0, BAD[0]))
    rig.run()
    assert CommandAborted(name) in rig.evrs
    rig.evrs.clear()
    rig.cycle(MoveJoints(floats(START)))
    assert rig.evrs == [CommandRefused("MoveJoints", "a fault stands; clear it first")]
    rig.cycle(ClearFault())
    assert rig.state.mode is (Mode.DEPLOYED if kind == "joints" else Mode.GUARDED)


def test_a_standing_fault_is_said_once():
    rig = moving()
    rig.evrs.clear()
    for _ in range(20):
        rig.cycle(**corrupted("gravity_R_m_s2", 1, BAD[0]))
    assert sum(isinstance(evr, SensorNotFinite) for evr in rig.evrs) == 1
    assert sum(isinstance(evr, FaultResponse) for evr in rig.evrs) == 1


def test_clearing_while_the_reading_is_still_bad_faults_again():
    rig = moving()
    rig.cycle(**corrupted("current_A", 0, BAD[0]))
    rig.run()
    rig.evrs.clear()
    rig.cycle(ClearFault(), MoveJoints(floats(START)), **corrupted("current_A", 0, BAD[0]))
    assert rig.state.mode is Mode.FAULTED
    assert SensorNotFinite("current_A") in rig.evrs
    assert not rig.outputs.drive.brake_release.any()


def test_bad_readings_of_several_sensors_are_all_named():
    rig = moving()
    bad = {**corrupted("current_A", 0, BAD[0]), **corrupted("gravity_R_m_s2", 2, BAD[1])}
    evrs = rig.cycle(**bad).evrs
    assert [evr.sensor for evr in evrs if isinstance(evr, SensorNotFinite)] == ["current_A", "gravity_R_m_s2"]


def test_a_bad_reading_leaves_the_last_good_estimate():
    rig = moving()
    before = rig.state.joints
    rig.cycle(**corrupted("gravity_R_m_s2", 0, BAD[0]))
    after = rig.state.joints
    for name in ("motor_rad", "gear_rad", "gravity_R_m_s2", "resolver_error_rad"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


@pytest.mark.parametrize("value", BAD)
def test_an_arm_on_its_brakes_faults_too(value):
    rig = Rig(CONFIG, start_rad=START)
    rig.cycle(**corrupted("winding_C", 4, value))
    assert rig.state.mode is Mode.FAULTED
    assert not rig.outputs.drive.power_on.any()


MIN_m_s2, MAX_m_s2 = CONFIG.params.monitors.gravity_min_m_s2, CONFIG.params.monitors.gravity_max_m_s2


@pytest.mark.parametrize("reads_m_s2", [0.0, 25.0])
@pytest.mark.parametrize("kind", MOVES)
def test_an_implausible_gravity_stops_the_arm_in_the_same_cycle_and_is_not_learnt(kind, reads_m_s2):
    rig = moving(kind)
    before, mode = rig.state.joints.gravity_R_m_s2, rig.state.mode
    out = rig.cycle(gravity_R_m_s2=[0.0, 0.0, reads_m_s2])
    assert out.evrs == (
        GravityImplausible(reads_m_s2, MIN_m_s2, MAX_m_s2),
        FaultResponse("BRAKE_AND_REFUSE"),
        ModeChanged(mode, Mode.FAULTED),
    )
    assert not out.drive.brake_release.any()
    assert not out.drive.setpoint_rate_rad_s.any()
    np.testing.assert_array_equal(rig.state.joints.gravity_R_m_s2, before)


@pytest.mark.parametrize("name", [*QUIET, "gravity_min", "gravity_max"])
def test_the_arm_comes_to_its_brakes_and_power_off_while_the_reading_stays_bad(name):
    rig = moving()
    finite_but_bad = {"gravity_min": 0.0, "gravity_max": 99.0}
    if name in finite_but_bad:
        bad = {"gravity_R_m_s2": [0, 0, finite_but_bad[name]]}
    else:
        bad = corrupted(name, 0, BAD[0])
    rig.run(**bad, at_most=CONFIG.brake_ticks + 2)
    assert not rig.outputs.drive.power_on.any()
    assert CommandAborted("MoveJoints") in rig.evrs


@pytest.mark.parametrize("name", QUIET)
def test_with_bad_readings_nothing_is_known_until_the_first_good_ones(name):
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    for _ in range(3):
        rig.cycle(**corrupted(name, 0, BAD[0]))
        assert not rig.state.joints.initialised
    rig.cycle()
    np.testing.assert_allclose(rig.state.joints.motor_rad, START, atol=1e-5)


def test_a_stop_does_not_clear_a_fault():
    rig = moving()
    rig.cycle(**corrupted("current_A", 0, BAD[0]))
    rig.run(Stop())
    assert rig.state.mode is Mode.FAULTED
