"""Contact where there should be none, none where there should be some, and forces that wind up the gears."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.faults import ContactInFreeSpace, ContactLost, PreloadOutside
from fsw.protect.contact import (
    FORCE_GAIN,
    FULL_LEVER_M,
    LEAST_LEVER_M,
    NOISE_RAD,
    REST_GAIN,
    UNCERTAIN_RAD,
    ApproachState,
    check_contact_kept,
    check_press_force,
    check_unexpected_contact,
    estimate_force_error,
    monitor_approach,
)
from tests.fsw.protect.lab import (
    BOUNDS,
    CONFIG,
    JOINTS,
    MONITORS,
    PARAMS,
    READY,
    STIFFNESS,
    WOUND_RAD,
    ZERO,
    a_move,
    a_press,
    above,
    assert_reports_from,
    at,
    below,
    closed,
    moving,
    resting,
    sensors,
)
from tests.fsw.rig import levers_m
from tests.tools import SWITCHES, TOOL_SWITCHES, TOOLS, WITH_SWITCHES

FREE = [Mode.STOWED, Mode.DEPLOYED, Mode.FREE_SPACE]
TOUCHING = [Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD]
GUARDED_N = MONITORS.guarded_force_N
SHARE = PARAMS.preload.error_share
with_switches = pytest.mark.parametrize("tool", WITH_SWITCHES)
joints = pytest.mark.parametrize("joint", Joint)


def test_every_mode_is_one_in_which_nothing_a_tool_or_anything_may_touch():
    """While a command is planned, protection sees the mode in which the arm rests."""
    assert {*FREE, *TOUCHING, Mode.FAULTED} == set(Mode) - {Mode.PLANNING}


@pytest.mark.parametrize("switch", SWITCHES)
def test_in_free_space_no_switch_may_close_and_after_a_fault_any_may(switch):
    for tool in TOOLS:
        for mode in FREE:
            assert check_unexpected_contact(BOUNDS, mode, tool, closed(switch)) == (
                ContactInFreeSpace(switch),
            )
        assert check_unexpected_contact(BOUNDS, Mode.FAULTED, tool, closed(switch)) == ()


@pytest.mark.parametrize("mode", TOUCHING)
@pytest.mark.parametrize("tool", TOOLS)
def test_where_a_tool_may_touch_its_own_switches_may_close_and_no_other(mode, tool):
    assert check_unexpected_contact(BOUNDS, mode, tool, closed(*TOOL_SWITCHES[tool])) == ()
    for switch in SWITCHES:
        found = check_unexpected_contact(BOUNDS, mode, tool, closed(*TOOL_SWITCHES[tool], switch))
        assert found == (() if switch in TOOL_SWITCHES[tool] else (ContactInFreeSpace(switch),))


def test_of_several_closed_switches_the_first_is_named():
    found = check_unexpected_contact(BOUNDS, Mode.DEPLOYED, "apxs", closed("drt_2", "drt_1"))
    assert found == (ContactInFreeSpace(min("drt_1", "drt_2")),)


@with_switches
def test_a_contact_is_lost_when_no_switch_of_the_tool_has_been_closed_for_exactly_its_persistence(tool):
    others = closed(*(switch for switch in SWITCHES if switch not in TOOL_SWITCHES[tool]))
    press = a_press(tool, above(GUARDED_N))
    assert_reports_from(
        MONITORS.contact_persistence,
        lambda count: check_contact_kept(BOUNDS, count, press, others),
        ContactLost(tool),
    )


@with_switches
def test_one_closed_switch_is_contact_and_a_tool_that_presses_no_more_than_a_touch_may_have_its_switches_open(
    tool,
):
    for switch in TOOL_SWITCHES[tool]:
        assert check_contact_kept(BOUNDS, 100, a_press(tool, 300.0), closed(switch)) == (0, ())
    for force_N in (GUARDED_N, 0.0, -1.0):
        assert check_contact_kept(BOUNDS, 100, a_press(tool, force_N), closed()) == (0, ())


def force_error(arm, torque_per_N, at_touch_rad=ZERO):
    return estimate_force_error(BOUNDS, arm, a_press(torque_per_N=torque_per_N, at_touch_rad=at_touch_rad))


def wound_by(torque_Nm, **changes):
    """Resolvers that show torques on the outputs which nobody believes in."""
    return resting(resolver_error_rad=torque_Nm / STIFFNESS, **changes)


def test_at_the_ready_pose_the_drill_has_leverage_enough_for_its_force_to_be_told():
    drill_m = levers_m(CONFIG.arm, "drill", READY)
    found_N, lever_m = force_error(wound_by(200.0 * drill_m), drill_m)
    assert found_N == pytest.approx(200.0)
    assert lever_m > LEAST_LEVER_M


levers = st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5).map(np.array)


@given(levers, st.floats(-500.0, 500.0))
def test_a_force_that_nobody_believes_in_is_found_from_the_wind_up_of_the_gears(lever_m, force_N):
    found_N, together_m = force_error(wound_by(force_N * lever_m), lever_m)
    # joints with less leverage together are not listened to
    if np.linalg.norm(lever_m) < LEAST_LEVER_M:
        assert (found_N, together_m) == (0.0, LEAST_LEVER_M)
    else:
        assert found_N == pytest.approx(force_N, rel=1e-9, abs=1e-9)
        assert together_m == pytest.approx(np.linalg.norm(lever_m))


@given(levers, st.lists(st.floats(-100, 100), min_size=5, max_size=5).map(np.array))
def test_a_torque_that_no_force_on_the_tool_takes_is_no_force(lever_m, torque_Nm):
    fitted_N, _ = force_error(wound_by(torque_Nm), lever_m)
    rest_N, _ = force_error(wound_by(torque_Nm - fitted_N * lever_m), lever_m)
    assert rest_N == pytest.approx(0.0 if np.linalg.norm(lever_m) >= LEAST_LEVER_M else fitted_N, abs=1e-6)


@joints
def test_a_lever_that_is_just_enough_is_listened_to(joint):
    for lever_m, heard in ((LEAST_LEVER_M, True), (below(LEAST_LEVER_M), False)):
        found_N, _ = force_error(wound_by(at(joint, 20.0)), at(joint, lever_m))
        assert bool(found_N) is heard


@joints
def test_joints_that_are_not_calibrated_or_may_cross_their_backlash_are_not_listened_to(joint):
    lever_m = np.full(5, 0.5)
    wound = wound_by(300.0 * lever_m)
    one_less_m = 0.5 * np.sqrt(4)
    unknown = wound._replace(calibrated=np.arange(5) != joint)
    assert force_error(unknown, lever_m) == pytest.approx((300.0, one_less_m))
    inside = at(joint, 0.0, WOUND_RAD)
    crossing = wound._replace(gear_lowest_rad=-inside, gear_highest_rad=inside)
    assert force_error(crossing, lever_m)[1] == LEAST_LEVER_M
    held_one_way = wound._replace(gear_lowest_rad=inside, gear_highest_rad=inside)
    assert force_error(held_one_way, lever_m) == pytest.approx((300.0, one_less_m))


@joints
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_joint_counts_that_half_the_bound_of_a_force_cannot_take_across_its_backlash(joint, sign):
    lever_m = at(joint, sign * 0.8)
    margin_rad = 0.5 * MONITORS.preload_error_N * 0.8 / STIFFNESS[joint]
    for share, counts in ((1.001, True), (0.999, False)):
        held = CONFIG.half_backlash_rad + share * margin_rad
        for lowest, highest in ((held, 2 * held), (-2 * held, -held)):
            arm = wound_by(300.0 * lever_m, gear_lowest_rad=lowest, gear_highest_rad=highest)
            assert bool(force_error(arm, lever_m)[0]) is counts


@given(levers, st.floats(1.0, 500.0), st.floats(0.0, 2e-3))
def test_what_is_not_known_of_a_gear_is_taken_for_no_force_whichever_way_it_would_point(
    lever_m, force_N, uncertainty_rad
):
    unsure = np.full(5, uncertainty_rad)
    arms = [wound_by(sign * force_N * lever_m, gear_uncertainty_rad=unsure) for sign in (1, -1)]
    forth, back = (force_error(arm, lever_m)[0] for arm in arms)
    assert forth == -back
    assert 0 <= forth <= force_N * (1 + 1e-9)
    hidden = np.abs(force_N * lever_m / STIFFNESS) <= uncertainty_rad
    if hidden.all():
        assert forth == 0


def test_what_a_force_shows_beyond_the_uncertainty_is_the_force():
    lever_m, unsure = at(Joint.ELEVATION, 1.0), np.full(5, 1e-3)
    shown = at(Joint.ELEVATION, 1e-3 + 50.0 / STIFFNESS[Joint.ELEVATION])
    arm = resting(resolver_error_rad=shown, gear_uncertainty_rad=unsure)
    assert force_error(arm, lever_m)[0] == pytest.approx(50.0)


@given(levers, st.lists(st.floats(-1e-2, 1e-2), min_size=5, max_size=5).map(np.array))
def test_what_the_resolvers_were_off_at_the_touch_is_no_force(lever_m, off_rad):
    assert force_error(resting(resolver_error_rad=off_rad), lever_m, at_touch_rad=off_rad)[0] == 0.0
    later = resting(resolver_error_rad=off_rad + 70.0 * lever_m / STIFFNESS)
    heard = np.linalg.norm(lever_m) >= LEAST_LEVER_M
    found_N = force_error(later, lever_m, at_touch_rad=off_rad)[0]
    assert found_N == pytest.approx(70.0 if heard else 0.0, abs=1e-6)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("lever_m", "factor"), [(FULL_LEVER_M, 1.0), (4.0, 1.0), (0.5, 2.0), (0.25, 4.0)])
@pytest.mark.parametrize("force_N", [0.0, 300.0])
def test_a_press_may_be_off_by_its_bound_and_more_with_a_short_lever(sign, lever_m, factor, force_N):
    bound_N = (MONITORS.preload_error_N + SHARE * force_N) * factor
    levers_m = at(Joint.ELEVATION, lever_m)
    press = a_press("drill", force_N, levers_m)
    for share, said in ((0.999999, False), (1.000001, True)):
        arm = wound_by(sign * share * bound_N * levers_m)
        count, found = check_press_force(BOUNDS, 1000, arm, press)
        assert count == (1001 if said else 0)
        if said:
            (evr,) = found
            assert evr == PreloadOutside("drill", force_N, evr.error_N, evr.bound_N)
            assert (evr.error_N, evr.bound_N) == pytest.approx((sign * share * bound_N, bound_N))


def with_stiffness_and_lever_exact(force_N):
    """An arm whose wind-up shows a force without rounding."""
    per_Nm = replace(BOUNDS, arm=replace(CONFIG.arm, gear_stiffness_Nm_rad=np.full(5, 2.0**17)))
    return per_Nm, resting(resolver_error_rad=at(Joint.ELEVATION, force_N / 2.0**17))


def test_a_force_at_its_bound_is_none_and_the_persistence_of_one_beyond_it_is_exact():
    bound_N, press = MONITORS.preload_error_N, a_press("drt", 0.0, at(Joint.ELEVATION, 1.0))
    bounds, arm = with_stiffness_and_lever_exact(bound_N)
    assert check_press_force(bounds, 100, arm, press) == (0, ())
    bounds, arm = with_stiffness_and_lever_exact(above(bound_N))
    event = PreloadOutside("drt", 0.0, above(bound_N), bound_N)
    persistence = MONITORS.preload_persistence
    assert_reports_from(persistence, lambda count: check_press_force(bounds, count, arm, press), event)


def approach(arm, last, **readings):
    return monitor_approach(BOUNDS, last, arm, sensors(**readings))


def approaching(tool="apxs", **changes):
    return moving(a_move(approaching=tool), **changes)


@pytest.mark.parametrize("arm", [resting(), moving()], ids=["resting", "moving"])
def test_unless_a_tool_approaches_no_force_is_looked_for(arm):
    last = ApproachState(np.ones(5), ZERO, 1e6)
    assert approach(arm, last, resolver_rad=np.ones(5)) == (None, ())


@with_switches
def test_an_approach_begins_with_no_force_and_the_wind_up_that_virtual_work_gives(tool):
    off_rad = np.array([1e-4, -2e-4, 3e-4, 0.0, 5e-5])
    state, found = approach(approaching(tool, resolver_error_rad=off_rad), None)
    assert found == ()
    assert state.force_N == 0.0
    np.testing.assert_array_equal(state.rest_rad, off_rad)
    expected = levers_m(CONFIG.arm, tool, READY + WOUND_RAD) / STIFFNESS
    np.testing.assert_allclose(state.rad_per_N, expected, atol=1e-12)


@joints
def test_a_gear_counts_on_an_approach_if_errors_of_its_load_cannot_take_it_across_its_backlash(joint):
    margin_rad = 5.0 * JOINTS[joint].load_error_Nm / STIFFNESS[joint]
    everything = approach(approaching(), None)[0].rad_per_N
    assert everything.all()
    for share, counts in ((1.001, True), (0.999, False)):
        held = at(joint, CONFIG.half_backlash_rad + share * margin_rad, WOUND_RAD)
        for lowest, highest in ((held, 2 * held), (-2 * held, -held)):
            state, _ = approach(approaching(gear_lowest_rad=lowest, gear_highest_rad=highest), None)
            np.testing.assert_array_equal(state.rad_per_N, everything * (counts | (np.arange(5) != joint)))


PER_N = np.array([2.0**-20, 2.0**-19, 2.0**-20, 2.0**-21, 2.0**-22])
ESTIMATED_RAD = READY + WOUND_RAD


def pushed(force_N, per_N=PER_N, rest_rad=ZERO, bias_rad=ZERO):
    """Resolvers of an arm on which something pushes."""
    return {"resolver_rad": ESTIMATED_RAD + bias_rad + rest_rad + force_N * per_N}


@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
def test_the_force_follows_what_the_resolvers_show_and_the_rest_follows_slowly(now_N, last_N):
    rest_rad, bias_rad = np.full(5, 1e-4), np.array([1e-3, 0.0, -1e-3, 2e-3, 0.0])
    last = ApproachState(PER_N, rest_rad, last_N)
    arm = approaching(resolver_bias_rad=bias_rad)
    state, found = approach(arm, last, **pushed(now_N, rest_rad=rest_rad, bias_rad=bias_rad))
    assert found == ()
    assert state.force_N == pytest.approx(last_N + (now_N - last_N) * FORCE_GAIN, abs=1e-6)
    np.testing.assert_allclose(state.rest_rad, rest_rad + now_N * PER_N * REST_GAIN, atol=1e-15)
    np.testing.assert_array_equal(state.rad_per_N, PER_N)


def test_two_thirds_of_what_resolvers_show_for_two_seconds_are_taken_for_the_arms_own():
    state = ApproachState(PER_N, ZERO, 0.0)
    for _ in range(2 * CYCLE_HZ):
        state, _ = approach(approaching(), state, **pushed(20.0))
    np.testing.assert_allclose(state.rest_rad / (20.0 * PER_N), 1 - np.exp(-1), atol=2e-3)


def test_resolvers_that_disagree_are_weighed_by_what_a_newton_winds_up():
    shown = np.array([1e-4, 2e-4, 3e-4, -1e-4, 2e-4])
    state, _ = approach(approaching(), ApproachState(PER_N, ZERO, 0.0), resolver_rad=ESTIMATED_RAD + shown)
    fitted_N = np.linalg.lstsq(PER_N[:, None], shown, rcond=None)[0][0]
    assert state.force_N == pytest.approx(FORCE_GAIN * fitted_N, rel=1e-6)


@joints
def test_a_gear_that_is_not_known_well_enough_shows_nothing_from_then_on(joint):
    last = ApproachState(PER_N, ZERO, 3.0)
    for unsure_rad, counts in ((below(UNCERTAIN_RAD), True), (UNCERTAIN_RAD, False)):
        state, _ = approach(approaching(gear_uncertainty_rad=at(joint, unsure_rad)), last, **pushed(0.0))
        assert bool(state.rad_per_N[joint]) is counts
        assert np.count_nonzero(state.rad_per_N) == (5 if counts else 4)
    assert approach(approaching(gear_uncertainty_rad=np.ones(5)), last, **pushed(50.0)) == (last, ())


EXACT = moving(a_move(approaching="mahli"), motor_rad=ZERO, gear_rad=ZERO)


@pytest.mark.parametrize(
    ("per_N", "bound_N"), [(2.0**-14, MONITORS.guarded_force_N), (2.0**-20, NOISE_RAD * 2.0**20)]
)
@joints
def test_a_force_beyond_its_bound_or_the_noise_is_reported_and_one_at_it_is_not(joint, per_N, bound_N):
    last = ApproachState(at(joint, per_N), ZERO, bound_N)
    assert bound_N >= MONITORS.guarded_force_N
    state, found = approach(EXACT, last, resolver_rad=at(joint, bound_N * per_N))
    assert (state.force_N, found) == (bound_N, ())
    state, found = approach(EXACT, last, resolver_rad=at(joint, (bound_N + 1.0) * per_N))
    assert found == (PreloadOutside("mahli", 0.0, state.force_N, bound_N),)
    assert state.force_N == pytest.approx(bound_N + FORCE_GAIN)


def test_a_tool_that_is_pulled_touches_nothing():
    state, found = approach(approaching(), ApproachState(PER_N, ZERO, -1e5), **pushed(-1e5))
    assert state.force_N < 0
    assert found == ()
