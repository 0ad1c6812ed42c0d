"""From the readings and bounds of a cycle to the decision: every monitor runs and is heard."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import CYCLE_S
from fsw.dictionary import faults
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, CyclesSkipped, FaultResponse
from fsw.protect.contact import ApproachState
from fsw.protect.inputs import NONE_UNCHANGED, compute_bounds
from fsw.protect.monitors import MonitorState, protect
from fsw.protect.responses import Response, StandingFault
from tests.fsw.protect.lab import (
    BOUNDS,
    CONFIG,
    JOINTS,
    MONITORS,
    PARAMS,
    READY,
    STIFFNESS,
    ZERO,
    a_move,
    a_press,
    at,
    closed,
    moving,
    noisy_readings,
    persistence_of,
    resting,
    run_monitors,
    sensors,
    with_readings,
)
from tests.fsw.rig import MARS_R_m_s2, alive
from tests.tools import SWITCHES

ELBOW, WRIST = Joint.ELBOW, Joint.WRIST
LEVERS_M = at(Joint.ELEVATION, 1.0)
PRESS = a_press("drill", 300.0, LEVERS_M)
PRESSED = closed("drill_1")


def live(cycle, **readings):
    """Readings of a cycle; of those with noise a little is."""
    noisy = {name: readings[name] + alive(cycle) for name in readings.keys() & {"current_A", "resolver_rad"}}
    return sensors(cycle, **{**readings, **noisy})


def pressing(**changes):
    return moving(a_move(press=PRESS), Mode.PRELOAD, tool="drill", **changes)


LAG_RAD = 0.5 * (MONITORS.stall_error_rad + MONITORS.following_error_rad)
STALLING = moving(a_move(setpoint_rad=READY + at(ELBOW, LAG_RAD), setpoint_rate_rad_s=at(ELBOW, 0.01)))
"""A motor that is asked to move and stands, not so far behind as to be reported for that."""
HOT, COLD = at(WRIST, 150.0, -40.0), at(WRIST, -130.0, -40.0)
HIGH_A = at(WRIST, CONFIG.current_limit_A[WRIST])
FAR = moving(a_move(setpoint_rad=READY + at(ELBOW, 0.02)))
OUTSIDE = at(ELBOW, BOUNDS.highest_rad[ELBOW] + 0.01, READY)
TURNED_R = np.array([2.0, 0.0, 3.0])
PERSISTENT = {
    faults.FollowingErrorHigh: ("following", FAR, {}),
    faults.MotorStalled: ("stalled", STALLING, {}),
    faults.OverCurrent: ("over_current", moving(), {"current_A": HIGH_A}),
    faults.OverTemperature: ("winding", resting(), {"winding_C": HOT}),
    faults.UnderTemperature: ("winding", moving(), {"winding_C": COLD}),
    faults.ResolverDisagrees: ("resolver", resting(resolver_error_rad=at(ELBOW, 1.0)), {}),
    faults.TiltChanged: ("tilt", moving(imu_R_m_s2=TURNED_R), {}),
    faults.ContactLost: ("contact", pressing(), {}),
    faults.PreloadOutside: (
        "press",
        pressing(resolver_error_rad=500.0 * LEVERS_M / STIFFNESS),
        {"switch_closed": PRESSED},
    ),
}
"""Name of the count, and an arm with readings beyond the bound."""
AT_ONCE = {
    faults.ContactInFreeSpace: (resting(), {"switch_closed": closed("drt_1")}),
    faults.SoftLimitPassed: (
        moving(a_move(setpoint_rad=OUTSIDE, setpoint_rate_rad_s=at(ELBOW, 0.01)), motor_rad=OUTSIDE),
        {},
    ),
}


def kinds(found):
    return [type(evr) for evr in found]


@pytest.mark.parametrize("kind", PERSISTENT, ids=lambda kind: kind.__name__)
def test_a_monitor_with_a_persistence_reports_from_it_on_counts_by_itself_and_from_the_start(kind):
    name, arm, readings = PERSISTENT[kind]
    state, persistence = MonitorState(), persistence_of(kind)
    for cycle in range(1, persistence + 4):
        state, found = run_monitors(BOUNDS, state, arm, live(cycle, **readings))
        assert kinds(found) == ([kind] if cycle >= persistence else [])
        counts = {field: getattr(state.counts, field) for field in state.counts.__slots__}
        assert counts.pop(name) == cycle
        assert set(counts.values()) == {0}
    quiet, state = pressing() if arm.mode is Mode.PRELOAD else moving(), MonitorState()
    for cycle in range(1, 4 * persistence):
        if cycle % persistence:
            state, found = run_monitors(BOUNDS, state, arm, live(cycle, **readings))
        else:
            state, found = run_monitors(BOUNDS, state, quiet, live(cycle, switch_closed=pressed(quiet)))
            assert state.counts == MonitorState().counts
        assert found == ()


def pressed(arm):
    return PRESSED if arm.mode is Mode.PRELOAD else closed()


@pytest.mark.parametrize("kind", AT_ONCE, ids=lambda kind: kind.__name__)
def test_a_monitor_without_a_persistence_reports_at_once(kind):
    arm, readings = AT_ONCE[kind]
    _, found = run_monitors(BOUNDS, MonitorState(), arm, live(1, **readings))
    assert kinds(found) == [kind]


def test_all_that_happens_in_a_cycle_is_reported_in_one_order():
    asked = {"setpoint_rad": OUTSIDE + at(ELBOW, 0.02), "setpoint_rate_rad_s": at(ELBOW, 0.01)}
    move = a_move(**asked, press=PRESS, approaching="drt")
    arm = moving(move, motor_rad=OUTSIDE, imu_R_m_s2=TURNED_R, resolver_error_rad=LEVERS_M, tool="drill")
    last = MonitorState()
    counts = replace(last.counts, **dict.fromkeys(last.counts.__slots__, 1000))
    readings = live(9, winding_C=HOT, current_A=HIGH_A, switch_closed=closed("drt_1"))
    last = MonitorState(
        counts,
        noisy_readings(readings),
        (1000,) * 14,
        MARS_R_m_s2,
        ApproachState(LEVERS_M, ZERO, 1e6, (1e6,) * 7),
    )
    state, found = run_monitors(BOUNDS, last, arm, readings)
    assert kinds(found) == [
        *[faults.SensorFrozen] * 4,
        faults.ContactInFreeSpace,
        faults.ResolverDisagrees,
        faults.OverTemperature,
        faults.SoftLimitPassed,
        faults.MotorStalled,
        faults.FollowingErrorHigh,
        faults.OverCurrent,
        faults.TiltChanged,
        faults.ContactLost,
        faults.PreloadOutside,
        faults.PreloadOutside,
    ]
    assert state.counts == replace(counts, **dict.fromkeys(counts.__slots__, 1001))
    assert state.unchanged == (1001,) * 14


@pytest.mark.parametrize("kind", [faults.MotorStalled, faults.FollowingErrorHigh, faults.OverCurrent])
def test_while_the_brakes_let_go_no_motor_is_expected_to_turn_or_to_be_anywhere(kind):
    persistence, (_, arm, readings) = persistence_of(kind), PERSISTENT[kind]
    arm = arm._replace(move=arm.move._replace(is_releasing=True))
    state = MonitorState()
    for cycle in range(1, 2 * persistence):
        state, found = run_monitors(BOUNDS, state, arm, live(cycle, **readings))
        assert found == ()
        assert state.counts == MonitorState().counts


def test_an_arm_that_is_being_stopped_may_be_cold():
    kind = faults.UnderTemperature
    persistence, (_, arm, readings) = persistence_of(kind), PERSISTENT[kind]
    for cold in (arm._replace(move=arm.move._replace(is_stopping=True)), resting()):
        state = MonitorState()
        for cycle in range(1, 2 * persistence):
            state, found = run_monitors(BOUNDS, state, cold, live(cycle, **readings))
            assert found == ()


def test_at_rest_motors_may_draw_or_stand_anywhere():
    state = MonitorState()
    arm = resting(motor_rad=OUTSIDE, imu_R_m_s2=TURNED_R)
    for cycle in range(1, 200):
        state, found = run_monitors(BOUNDS, state, arm, live(cycle, current_A=HIGH_A))
        assert found == ()
        assert state.planned_gravity_R is None


def test_a_move_is_held_to_the_gravity_with_which_it_began():
    begun = moving(gravity_R_m_s2=TURNED_R, imu_R_m_s2=TURNED_R)
    state, _ = run_monitors(BOUNDS, MonitorState(), begun, live(1))
    assert state.planned_gravity_R is TURNED_R
    later = moving(gravity_R_m_s2=MARS_R_m_s2, imu_R_m_s2=TURNED_R)
    for cycle in range(2, 2 * MONITORS.tilt_persistence):
        state, found = run_monitors(BOUNDS, state, later, live(cycle))
        assert found == ()
        assert state.planned_gravity_R is TURNED_R
    state, _ = run_monitors(BOUNDS, state, resting(), live(cycle + 1))
    assert state.planned_gravity_R is None


def test_monitors_remember_readings_counts_and_the_approach():
    readings = live(5)
    state, found = run_monitors(BOUNDS, MonitorState(), moving(a_move(approaching="apxs")), readings)
    assert found == ()
    assert (state.readings, state.unchanged) == (noisy_readings(readings), NONE_UNCHANGED)
    assert state.approach.force_N == 0.0
    state, found = run_monitors(BOUNDS, state, moving(), replace(readings, cycle=7))
    assert found == ()
    assert state.approach is None
    assert state.unchanged == (1,) * 14


def test_a_force_on_a_tool_that_approaches_is_reported():
    arm, state = moving(a_move(approaching="apxs")), MonitorState()
    state, _ = run_monitors(BOUNDS, state, arm, live(1))
    shown = READY + arm.gear_rad + 500.0 * state.approach.rad_per_N
    for cycle in range(2, 4):
        state, found = run_monitors(BOUNDS, state, arm, live(cycle, resolver_rad=shown))
    assert kinds(found) == [faults.PreloadOutside]
    assert found[0].tool == "apxs"


def test_of_unusable_readings_only_whether_the_arm_moves_counts():
    known = MonitorState(replace(MonitorState().counts, tilt=3), (1.0,) * 13, (2,) * 13, None)
    arm = moving(gravity_R_m_s2=TURNED_R, motor_rad=OUTSIDE)
    state, found = run_monitors(BOUNDS, known, arm, live(6, current_A=np.full(5, np.nan)), usable=False)
    assert found == ()
    assert (state.counts, state.readings, state.unchanged) == (known.counts, known.readings, known.unchanged)
    assert state.planned_gravity_R is TURNED_R
    assert run_monitors(BOUNDS, state, resting(), live(7), usable=False)[0].planned_gravity_R is None


def protected(arm, fault=None, of_readings=(), of_move=(), last_rad=READY, usable=True, **readings):
    read = live(1, **readings)
    judged = with_readings(read, usable)
    return protect(BOUNDS, MonitorState(), fault, arm, read, judged, last_rad, of_readings, of_move)


def test_nothing_is_decided_unless_something_happens():
    for arm in (resting(), moving(), pressing()):
        state, decision = protected(arm, switch_closed=pressed(arm))
        assert decision is None
        assert state.unchanged == NONE_UNCHANGED
    for closed_ones in (closed("drt_1"), closed(*SWITCHES)):
        _, decision = protected(resting(), switch_closed=closed_ones)
        assert kinds(decision.evrs) == [faults.ContactInFreeSpace, FaultResponse]


def test_what_readings_monitors_set_point_and_move_say_is_decided_upon_together():
    of_readings = (faults.ReadingImplausible("winding_C[0]", np.inf, -150.0, 250.0), CyclesSkipped(1))
    of_move = (faults.NoContact(0.1), CommandAborted("GuardedMove"))
    jump = moving(a_move(setpoint_rad=READY + at(WRIST, 1.0)))
    _, decision = protected(jump, None, of_readings, of_move)
    unsafe = faults.SetpointUnsafe(WRIST, READY[WRIST] + 1.0, READY[WRIST])
    found = (*of_readings, unsafe, *of_move)
    assert decision.evrs == (*found, FaultResponse("BRAKE_AND_REFUSE"))
    assert decision.response is Response.BRAKE_AND_REFUSE
    assert decision.fault.mode is Mode.FREE_SPACE
    np.testing.assert_array_equal(decision.hold_rad, READY)


def test_a_set_point_is_compared_with_the_last_one_and_only_that_of_a_move():
    ahead = READY + at(WRIST, 1.0)
    assert protected(moving(a_move(setpoint_rad=READY)), last_rad=READY)[1] is None
    _, decision = protected(moving(), last_rad=ahead)
    assert decision.evrs[0] == faults.SetpointUnsafe(WRIST, READY[WRIST], ahead[WRIST])
    bound = MONITORS.following_error_rad
    np.testing.assert_allclose(decision.hold_rad, ahead - at(WRIST, bound), atol=1e-15)
    assert protected(resting(), last_rad=ahead)[1] is None


def test_with_unusable_readings_nothing_is_monitored_by_them():
    bad = (faults.ReadingImplausible("current_A[0]", np.inf, -6.0, 6.0),)
    _, decision = protected(resting(), None, bad, usable=False, switch_closed=closed("drt_1"))
    assert decision.evrs == (*bad, FaultResponse("BRAKE_AND_REFUSE"))


def test_events_that_are_no_faults_pass_and_a_standing_fault_goes_on_to_stand():
    done = (CommandCompleted("MoveJoints"),)
    _, decision = protected(moving(), of_move=done)
    assert (decision.response, decision.evrs, decision.fault) == (None, done, None)
    fault = StandingFault(Mode.GUARDED, frozenset({(faults.NoContact, None)}))
    _, decision = protected(resting(mode=Mode.FAULTED), fault, of_move=(faults.NoContact(0.3), *done))
    assert (decision.response, decision.evrs) == (None, done)
    assert decision.fault.mode is Mode.GUARDED


LOW, HIGH = CONFIG.arm.soft_min_rad, CONFIG.arm.soft_max_rad


def bounds_of(**monitors):
    return compute_bounds(replace(PARAMS, monitors=replace(MONITORS, **monitors)), CONFIG.arm, CYCLE_S)


def of_joints(name):
    return np.array([getattr(joint, name) for joint in JOINTS])


@pytest.mark.parametrize("margin_rad", [0.0, 0.01, 0.03])
def test_motors_may_go_a_margin_beyond_the_soft_limits(margin_rad):
    bounds = bounds_of(soft_limit_margin_rad=margin_rad)
    np.testing.assert_allclose(LOW - bounds.lowest_rad, margin_rad, atol=1e-12)
    np.testing.assert_allclose(bounds.highest_rad - HIGH, margin_rad, atol=1e-12)


def test_only_the_joint_in_homing_may_go_two_windows_beyond_it():
    bounds, window_rad = bounds_of(), PARAMS.hardstop.window_rad
    beyond_rad = of_joints("hardstop_rad") - bounds.lowest_homing_rad
    np.testing.assert_allclose(np.diag(beyond_rad), 2 * window_rad, atol=1e-12)
    for joint, lowest_rad in enumerate(bounds.lowest_homing_rad):
        others = np.arange(5) != joint
        np.testing.assert_array_equal(lowest_rad[others], bounds.lowest_rad[others])
        assert lowest_rad[joint] < bounds.lowest_rad[joint]


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_a_set_point_may_step_as_far_as_a_joint_goes_in_so_many_cycles(factor):
    steps_a_second = (
        of_joints("speed_rad_s") * factor / bounds_of(setpoint_step_factor=factor).setpoint_step_rad
    )
    np.testing.assert_allclose(steps_a_second, 64.0)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_motor_may_draw_its_share_of_the_limit(share):
    bounds = bounds_of(over_current_fraction=share)
    np.testing.assert_allclose(bounds.over_current_A, share * of_joints("current_limit_A"))


def test_a_gear_counts_on_an_approach_from_five_times_the_error_of_its_load_on():
    errors = bounds_of().approach_wind_up_rad * STIFFNESS / of_joints("load_error_Nm")
    np.testing.assert_allclose(errors, 5.0)


def test_what_protection_needs_of_a_press_and_of_the_arm_is_that_of_the_parameters():
    params = replace(PARAMS, preload=replace(PARAMS.preload, error_share=0.125))
    bounds = compute_bounds(params, CONFIG.arm, CYCLE_S)
    assert bounds.press_error_share == 0.125
    assert bounds.arm is CONFIG.arm
    assert bounds.monitors is PARAMS.monitors


@pytest.mark.parametrize(("stall_rad", "following_rad"), [(1e-3, 2e-3), (2e-3, 1e-3)])
def test_what_is_compared_in_every_cycle_is_the_least_bound_of_each_value(stall_rad, following_rad):
    bounds = bounds_of(stall_error_rad=stall_rad, following_error_rad=following_rad)
    lowest, highest = (
        np.reshape(values, (5, 5)) for values in (bounds.monitored_lowest, bounds.monitored_highest)
    )
    assert all(type(value) is float for value in (*bounds.monitored_lowest, *bounds.monitored_highest))
    np.testing.assert_array_equal(lowest[0], bounds.lowest_rad)
    np.testing.assert_array_equal(highest[0], bounds.highest_rad)
    for row, value in ((1, 1e-3), (2, bounds.over_current_A), (4, MONITORS.resolver_error_rad)):
        np.testing.assert_array_equal(highest[row], np.broadcast_to(value, 5))
        np.testing.assert_array_equal(lowest[row], -highest[row])
    assert set(lowest[3]) == {MONITORS.winding_min_C}
    assert set(highest[3]) == {MONITORS.winding_max_C}
