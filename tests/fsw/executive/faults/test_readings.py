"""What is done about readings that are no number, frozen, missed or turned, and resolvers that disagree."""

import numpy as np
import pytest

from fsw.dictionary import evrs
from fsw.dictionary.commands import ClearFault, MoveJoints, Retract
from fsw.dictionary.enums import Mode
from fsw.dictionary.faults import CyclesMissed, GravityImplausible, SensorFrozen, SensorNotFinite
from tests.fsw.executive.faults.lab import BOUNDS, CONFIG, START, STOPPED, found, moving, skip
from tests.fsw.protect.test_readings import BAD, QUIET, corrupted
from tests.fsw.rig import MARS_R_m_s2, Rig, floats, made_once

MOVES = {
    "joints": lambda rig: MoveJoints(floats(START + 0.05)),
    "guarded": lambda rig: rig.touch("apxs", 0.1),
    "retract": lambda rig: Retract("apxs", 0.1),
}


@made_once
def on_its_way(kind):
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(MOVES[kind](rig))
    return rig


@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize("value", BAD)
def test_from_the_bad_reading_on_the_set_point_is_frozen_and_moves_are_refused_until_the_fault_is_cleared(
    kind, value
):
    rig = on_its_way(kind)
    name = rig.state.move.plan.command
    follow, mode = rig.outputs.drive.setpoint_count, rig.state.mode
    out = rig.cycle(**corrupted("current_A", 2, value))
    assert out.evrs == (
        SensorNotFinite("current_A"),
        evrs.FaultResponse("BRAKE_AND_REFUSE"),
        evrs.ModeChanged(mode, Mode.FAULTED),
    )
    # held where the motors were last seen: no farther than the cycle just passed
    held, step = out.drive.setpoint_count, np.ceil(CONFIG.speed_rad_s / 64 / CONFIG.rad_per_count)
    assert (np.abs(held - follow) <= step).all()
    for k in range(60):
        out = rig.cycle(**(corrupted("winding_C", k % 5, value) if k % 3 == 0 else {}))
        np.testing.assert_array_equal(out.drive.setpoint_count, held)
        assert not out.drive.setpoint_rate_rad_s.any()
        assert not out.drive.brake_release.any()
        assert np.isfinite([out.drive.setpoint_rate_rad_s, out.drive.current_limit_A]).all()
    assert not out.drive.power_on.any()
    assert rig.state.mode is Mode.FAULTED
    assert evrs.CommandAborted(name) in rig.evrs
    rig.evrs.clear()
    rig.cycle(MoveJoints(floats(START)))
    assert rig.evrs == [evrs.CommandRefused("MoveJoints", "a fault stands; clear it first")]
    rig.cycle(ClearFault())
    assert rig.state.mode is (Mode.DEPLOYED if kind == "joints" else Mode.GUARDED)


def test_a_bad_reading_leaves_the_last_good_estimate():
    rig = moving()
    before = rig.state.joints
    rig.cycle(**corrupted("gravity_R_m_s2", 0, BAD[0]))
    after = rig.state.joints
    for name in ("motor_rad", "gear_rad", "gravity_R_m_s2", "resolver_error_rad"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


MIN_m_s2, MAX_m_s2 = CONFIG.params.monitors.gravity_min_m_s2, CONFIG.params.monitors.gravity_max_m_s2


@pytest.mark.parametrize("reads_m_s2", [0.0, 25.0])
@pytest.mark.parametrize("kind", MOVES)
def test_an_implausible_gravity_stops_the_arm_in_the_same_cycle_and_is_not_learnt(kind, reads_m_s2):
    rig = on_its_way(kind)
    before, mode = rig.state.joints.gravity_R_m_s2, rig.state.mode
    out = rig.cycle(gravity_R_m_s2=[0.0, 0.0, reads_m_s2])
    assert out.evrs == (
        GravityImplausible(reads_m_s2, MIN_m_s2, MAX_m_s2),
        evrs.FaultResponse("BRAKE_AND_REFUSE"),
        evrs.ModeChanged(mode, Mode.FAULTED),
    )
    assert not out.drive.brake_release.any()
    assert not out.drive.setpoint_rate_rad_s.any()
    np.testing.assert_array_equal(rig.state.joints.gravity_R_m_s2, before)


@pytest.mark.parametrize("name", QUIET)
def test_with_bad_readings_nothing_is_known_until_the_first_good_ones(name):
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    for _ in range(3):
        rig.cycle(**corrupted(name, 0, BAD[0]))
        assert not rig.state.joints.initialised
    rig.cycle()
    np.testing.assert_allclose(rig.state.joints.motor_rad, START, atol=1e-5)


LIVELY = {"resolver_rad": 5, "current_A": 5, "gravity_R_m_s2": 3}


def test_all_frozen_sensors_are_named_once_each_and_again_after_clearing():
    rig = Rig(CONFIG, start_rad=START)
    frozen = {name: np.ones(size) for name, size in LIVELY.items()}
    frozen["gravity_R_m_s2"] = MARS_R_m_s2
    for _ in range(2 * BOUNDS.frozen_persistence):
        rig.cycle(**frozen)
    assert [evr.sensor for evr in found(rig, SensorFrozen)] == list(LIVELY)
    rig.evrs.clear()
    rig.cycle(ClearFault(), **frozen)
    assert [evr.sensor for evr in found(rig, SensorFrozen)] == list(LIVELY)
    assert rig.state.mode is Mode.FAULTED


def test_cycles_missed_at_rest_are_reported_and_stop_nothing():
    rig = Rig(CONFIG, start_rad=START)
    rig.evrs.clear()
    skip(rig, 20)
    assert rig.evrs == [CyclesMissed(20, BOUNDS.missed_cycles), STOPPED]
    assert rig.state.mode is Mode.DEPLOYED
