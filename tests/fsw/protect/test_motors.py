"""Joints that do what they should not: at a bound nothing is reported, beyond it the worst joint is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.config import CYCLE_S
from fsw.dictionary import faults
from fsw.dictionary.enums import Joint
from fsw.protect.monitors import (
    ROUNDING_RAD,
    check_current,
    check_following,
    check_resolvers,
    check_setpoint,
    check_soft_limits,
    check_stall,
    check_windings,
    exceed_any_bound,
)
from tests.fsw.protect.lab import (
    BOUNDS,
    CONFIG,
    JOINTS,
    MONITORS,
    PARAMS,
    READY,
    ZERO,
    a_move,
    above,
    assert_reports_from,
    at,
    below,
    moving,
    resting,
    sensors,
)

LOW, HIGH = CONFIG.arm.soft_min_rad, CONFIG.arm.soft_max_rad
LOWEST = LOW - MONITORS.soft_limit_margin_rad
HIGHEST = HIGH + MONITORS.soft_limit_margin_rad
STEP = MONITORS.setpoint_step_factor * CYCLE_S * CONFIG.speed_rad_s
WIDE = replace(BOUNDS, lowest_rad=np.full(5, -10.0), highest_rad=np.full(5, 10.0))
"""Soft limits that no angle of these tests reaches."""
BAD = [float("nan"), float("inf"), float("-inf")]
joints = pytest.mark.parametrize("joint", Joint)
ends = pytest.mark.parametrize(("end", "outward"), [("low", -1), ("high", 1)])


def unsafe_setpoint(last_rad, setpoint_rad, homing=None, bounds=BOUNDS):
    return check_setpoint(bounds, a_move(setpoint_rad=setpoint_rad, homing=homing), last_rad)


@joints
@pytest.mark.parametrize("value", BAD)
def test_what_is_no_number_does_not_go_out_and_nothing_after_it(joint, value):
    (evr,) = unsafe_setpoint(READY, at(joint, value, READY))
    assert isinstance(evr, faults.SetpointUnsafe)
    assert evr.joint is joint
    assert evr.last_rad == READY[joint]
    assert unsafe_setpoint(at(joint, np.nan, READY), READY) != ()


@joints
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_jump_is_a_step_larger_than_speed_and_factor_allow(joint, sign):
    step = sign * STEP[joint]
    assert unsafe_setpoint(ZERO, at(joint, step), bounds=WIDE) == ()
    for jump in (sign * above(STEP[joint]), 1e6 * step):
        assert unsafe_setpoint(ZERO, at(joint, jump), bounds=WIDE) == (
            faults.SetpointUnsafe(joint, jump, 0.0),
        )


def test_of_several_set_points_that_must_not_go_out_the_first_is_named_and_none_is_left_out():
    (evr,) = unsafe_setpoint(ZERO, np.array([0.0, 0.0, 5.0, 0.0, 9.0]), bounds=WIDE)
    assert evr == faults.SetpointUnsafe(Joint.ELBOW, 5.0, 0.0)
    with pytest.raises(ValueError, match="shorter"):
        unsafe_setpoint(READY[:4], READY)


def edge(joint, end):
    return LOWEST[joint] if end == "low" else HIGHEST[joint]


@joints
@ends
def test_beyond_limit_and_margin_a_set_point_may_stay_or_go_back_but_not_out(joint, end, outward):
    small = 0.1 * STEP[joint]
    for before, after, said in (
        (-2 * small, -small, False),
        (-small, 0.0, False),
        (-small, small, True),
        (small, 2 * small, True),
        (small, small, False),
        (2 * small, small, False),
        (small, -small, False),
    ):
        last, commanded = (at(joint, edge(joint, end) + outward * off, READY) for off in (before, after))
        assert bool(unsafe_setpoint(last, commanded)) is said


@joints
@ends
def test_the_last_number_inside_limit_and_margin_goes_out_and_the_next_one_does_not(joint, end, outward):
    limit = edge(joint, end)
    last = at(joint, limit - outward * 0.1 * STEP[joint], READY)
    assert unsafe_setpoint(last, at(joint, limit, READY)) == ()
    assert unsafe_setpoint(last, at(joint, np.nextafter(limit, outward * np.inf), READY)) != ()


@joints
@ends
def test_beyond_the_limit_rounding_is_no_motion_outward(joint, end, outward):
    last = edge(joint, end) + outward * 0.1
    drifted = last + outward * ROUNDING_RAD
    assert unsafe_setpoint(at(joint, last, READY), at(joint, drifted, READY)) == ()
    assert unsafe_setpoint(at(joint, last, READY), at(joint, drifted + outward * 1e-12, READY)) != ()


@joints
@pytest.mark.parametrize("other", Joint)
def test_only_the_joint_in_homing_may_be_sent_there_and_not_far_beyond_it(joint, other):
    stop = JOINTS[other].hardstop_rad
    small = 0.1 * STEP[other]
    farthest = stop - 2 * PARAMS.hardstop.window_rad
    for angle, said in ((stop, other is not joint), (farthest + small, other is not joint), (farthest, True)):
        last, commanded = angle + 0.5 * small, angle - 0.5 * small
        found = unsafe_setpoint(at(other, last, READY), at(other, commanded, READY), joint)
        assert bool(found) is said


moves = hnp.arrays(float, 5, elements=st.floats(-1, 1))


@given(moves, moves)
def test_inside_the_limits_every_step_a_move_can_make_goes_out(where, step):
    last = LOW + (0.05 + 0.45 * (where + 1)) * (HIGH - LOW)
    commanded = np.clip(last + step * CYCLE_S * CONFIG.speed_rad_s, LOW, HIGH)
    assert unsafe_setpoint(last, commanded) == ()


LAG_RAD = min(MONITORS.stall_error_rad, MONITORS.following_error_rad)
OVER_A = MONITORS.over_current_fraction * CONFIG.current_limit_A
ANY_ANGLE = replace(
    BOUNDS,
    monitored_lowest=(-10.0,) * 5 + BOUNDS.monitored_lowest[5:],
    monitored_highest=(10.0,) * 5 + BOUNDS.monitored_highest[5:],
)


def standing_at(joint, angle_rad):
    return resting(motor_rad=at(joint, angle_rad, READY))


def windings(joint, winding_C):
    return {"winding_C": at(joint, winding_C, -40.0)}


def resolver_off(joint, off_rad):
    return resting(resolver_error_rad=at(joint, off_rad))


def lagging(joint, lag_rad):
    return moving(a_move(setpoint_rad=ZERO), motor_rad=at(joint, lag_rad))


RESOLVER_RAD = MONITORS.resolver_error_rad
MONITORED = {
    "angle below": (BOUNDS, below, lambda j, beyond: (standing_at(j, beyond(LOWEST[j])), {})),
    "angle above": (BOUNDS, above, lambda j, beyond: (standing_at(j, beyond(HIGHEST[j])), {})),
    "behind": (ANY_ANGLE, above, lambda j, beyond: (lagging(j, -beyond(LAG_RAD)), {})),
    "ahead": (ANY_ANGLE, above, lambda j, beyond: (lagging(j, beyond(LAG_RAD)), {})),
    "current below": (BOUNDS, above, lambda j, beyond: (moving(), {"current_A": at(j, -beyond(OVER_A[j]))})),
    "current above": (BOUNDS, above, lambda j, beyond: (moving(), {"current_A": at(j, beyond(OVER_A[j]))})),
    "cold": (BOUNDS, below, lambda j, beyond: (moving(), windings(j, beyond(MONITORS.winding_min_C)))),
    "hot": (BOUNDS, above, lambda j, beyond: (resting(), windings(j, beyond(MONITORS.winding_max_C)))),
    "resolver below": (BOUNDS, above, lambda j, beyond: (resolver_off(j, -beyond(RESOLVER_RAD)), {})),
    "resolver above": (BOUNDS, above, lambda j, beyond: (resolver_off(j, beyond(RESOLVER_RAD)), {})),
}
"""Bounds, which numbers are beyond, and the arm and its readings with one joint at such a number."""


@joints
@pytest.mark.parametrize("name", MONITORED)
def test_the_monitors_of_joints_are_run_as_soon_as_any_joint_is_beyond_any_bound_and_not_before(name, joint):
    bounds, beyond, trouble = MONITORED[name]
    for number, said in ((lambda bound: bound, False), (beyond, True)):
        arm, readings = trouble(joint, number)
        assert exceed_any_bound(bounds, arm, sensors(**readings)) is said


def test_a_lag_is_of_a_move_and_an_arm_at_rest_has_none():
    behind = READY + 10 * LAG_RAD
    assert not exceed_any_bound(BOUNDS, resting(motor_rad=behind), sensors())
    assert exceed_any_bound(BOUNDS, moving(motor_rad=behind), sensors())


@joints
@ends
def test_a_joint_that_is_moved_outward_beyond_soft_limit_and_margin_is_reported_with_its_limit(
    joint, end, outward
):
    limit = edge(joint, end)
    angle = np.nextafter(limit, outward * np.inf)
    soft = LOW[joint] if end == "low" else HIGH[joint]
    out = a_move(setpoint_rate_rad_s=at(joint, outward * 1e-9))
    assert check_soft_limits(BOUNDS, out, at(joint, limit, READY)) == ()
    found = check_soft_limits(BOUNDS, out, at(joint, angle, READY))
    assert found == (faults.SoftLimitPassed(joint, angle, soft),)
    for rate_rad_s in (0.0, -outward * 1e-9):
        back = a_move(setpoint_rate_rad_s=at(joint, rate_rad_s))
        assert check_soft_limits(BOUNDS, back, at(joint, angle, READY)) == ()


@joints
def test_a_joint_in_homing_has_its_limit_beyond_it(joint):
    farthest = JOINTS[joint].hardstop_rad - 2 * PARAMS.hardstop.window_rad
    down = a_move(homing=joint, setpoint_rate_rad_s=at(joint, -0.01))
    assert check_soft_limits(BOUNDS, down, at(joint, farthest, READY)) == ()
    found = check_soft_limits(BOUNDS, down, at(joint, below(farthest), READY))
    assert found == (faults.SoftLimitPassed(joint, below(farthest), farthest),)
    other = Joint((joint + 1) % 5)
    found = check_soft_limits(
        BOUNDS,
        a_move(homing=joint, setpoint_rate_rad_s=at(other, -0.01)),
        at(other, LOWEST[other] - 0.01, READY),
    )
    assert [evr.joint for evr in found] == [other]


def test_of_two_joints_beyond_their_limits_the_one_that_is_moved_outward_is_named():
    outside = READY.copy()
    outside[Joint.ELEVATION], outside[Joint.WRIST] = LOWEST[Joint.ELEVATION] - 0.1, HIGHEST[Joint.WRIST] + 0.1
    inward_and_outward = a_move(setpoint_rate_rad_s=np.array([0.0, 0.01, 0.0, 0.01, 0.0]))
    (evr,) = check_soft_limits(BOUNDS, inward_and_outward, outside)
    assert evr == faults.SoftLimitPassed(Joint.WRIST, outside[Joint.WRIST], HIGH[Joint.WRIST])
    both = a_move(setpoint_rate_rad_s=np.array([0.0, -0.01, 0.0, 0.01, 0.0]))
    (evr,) = check_soft_limits(BOUNDS, both, outside)
    assert evr.joint is Joint.ELEVATION


@joints
def test_a_following_error_is_reported_of_the_joint_that_is_farthest(joint):
    bound, persistence = MONITORS.following_error_rad, MONITORS.following_persistence
    assert check_following(BOUNDS, 100, at(joint, bound, 0.5 * bound)) == (0, ())
    far = at(joint, above(bound), bound)
    event = faults.FollowingErrorHigh(joint, above(bound), bound)
    assert_reports_from(persistence, lambda count: check_following(BOUNDS, count, far), event)


ASKED = 0.01
SHARE = MONITORS.stall_share


def stall(count, joint, rate_rad_s, commanded_rad_s, error_rad=1.0, homing=None):
    """A joint commanded one rate that turns at another; the others turn as they are asked to."""
    move = a_move(setpoint_rate_rad_s=at(joint, commanded_rad_s, ASKED), homing=homing)
    return check_stall(BOUNDS, count, move, at(joint, error_rad, 1.0), at(joint, rate_rad_s, ASKED))


@joints
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_motor_has_stalled_if_it_turns_less_than_its_share_of_what_is_asked(joint, sign):
    commanded, slow = sign * ASKED, sign * below(SHARE * ASKED)
    assert stall(100, joint, sign * SHARE * ASKED, commanded) == (0, ())
    event = faults.MotorStalled(joint, slow, commanded)
    assert_reports_from(MONITORS.stall_persistence, lambda count: stall(count, joint, slow, commanded), event)
    wrong_way = faults.MotorStalled(joint, -commanded, commanded)
    assert stall(1000, joint, -commanded, commanded) == (1001, (wrong_way,))


@joints
def test_a_motor_near_its_set_point_or_asked_to_stand_or_in_homing_has_not_stalled(joint):
    bound = MONITORS.stall_error_rad
    assert stall(100, joint, 0.0, ASKED, error_rad=bound) == (0, ())
    assert stall(100, joint, 0.0, ASKED, error_rad=above(bound))[0] == 101
    assert stall(100, joint, -1.0, 0.0) == (0, ())
    assert stall(100, joint, 0.0, ASKED, homing=Joint.AZIMUTH) == (0, ())


def test_motors_that_all_lag_have_stalled_only_if_they_lack_their_rate_and_the_worst_is_named():
    move = a_move(setpoint_rate_rad_s=np.array([0.01, -0.02, 0.01, -0.01, 0.03]))
    assert check_stall(BOUNDS, 100, move, np.ones(5), move.setpoint_rate_rad_s) == (0, ())
    move = a_move(setpoint_rate_rad_s=np.array([0.01, 0.02, 0.01, 0.01, 0.01]))
    _, (evr,) = check_stall(BOUNDS, 1000, move, np.ones(5), ZERO)
    assert evr == faults.MotorStalled(Joint.ELEVATION, 0.0, 0.02)


@joints
@pytest.mark.parametrize("sign", [-1, 1])
def test_an_over_current_is_reported_of_the_motor_that_is_farthest_beyond_its_bound(joint, sign):
    bound = OVER_A[joint]
    assert check_current(BOUNDS, 100, sign * OVER_A) == (0, ())
    high = at(joint, sign * (bound + 0.01), sign * OVER_A + sign * 0.005)
    event = faults.OverCurrent(joint, sign * (bound + 0.01), bound)
    assert_reports_from(
        MONITORS.over_current_persistence, lambda count: check_current(BOUNDS, count, high), event
    )
    assert check_current(BOUNDS, 0, at(joint, above(bound)))[0] == 1


@joints
@pytest.mark.parametrize("is_moving", [True, False])
def test_a_hot_winding_is_reported_whether_the_arm_moves_or_not(joint, is_moving):
    bound, persistence = MONITORS.winding_max_C, MONITORS.winding_persistence
    assert check_windings(BOUNDS, 100, is_moving, at(joint, bound, 20.0)) == (0, ())
    hot = at(joint, above(bound), bound)
    event = faults.OverTemperature(joint, above(bound), bound)
    assert_reports_from(persistence, lambda count: check_windings(BOUNDS, count, is_moving, hot), event)


@joints
def test_a_cold_winding_is_reported_of_an_arm_that_moves_unless_another_is_hot(joint):
    bound, persistence = MONITORS.winding_min_C, MONITORS.winding_persistence
    assert check_windings(BOUNDS, 100, True, at(joint, bound, 20.0)) == (0, ())
    cold = at(joint, below(bound), bound)
    event = faults.UnderTemperature(joint, below(bound), bound)
    assert_reports_from(persistence, lambda count: check_windings(BOUNDS, count, True, cold), event)
    assert check_windings(BOUNDS, 100, False, cold) == (0, ())
    _, found = check_windings(BOUNDS, 1000, True, np.array([200.0, -140.0, 0.0, 0.0, 0.0]))
    assert found == (faults.OverTemperature(Joint.AZIMUTH, 200.0, MONITORS.winding_max_C),)


@joints
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_resolver_is_reported_beyond_its_bound_and_what_is_unknown_of_its_gear(joint, sign):
    bound = MONITORS.resolver_error_rad
    assert check_resolvers(BOUNDS, 100, resting(resolver_error_rad=at(joint, sign * bound))) == (0, ())
    off = resting(resolver_error_rad=at(joint, sign * 2 * bound, sign * 1.5 * bound))
    event = faults.ResolverDisagrees(joint, sign * 2 * bound, bound)
    assert_reports_from(
        MONITORS.resolver_persistence, lambda count: check_resolvers(BOUNDS, count, off), event
    )
    unsure = off._replace(gear_uncertainty_rad=at(joint, 0.75 * bound, bound))
    _, (evr,) = check_resolvers(BOUNDS, 1000, unsure)
    assert (evr.joint, evr.error_rad) == (joint, sign * 2 * bound)
    assert evr.bound_rad == pytest.approx(1.75 * bound, rel=1e-12)
    assert check_resolvers(BOUNDS, 100, off._replace(gear_uncertainty_rad=np.full(5, bound))) == (0, ())
    # one that is not calibrated disagrees with nothing
    unknown = resting(resolver_error_rad=at(joint, 1.0), calibrated=np.arange(5) != joint)
    assert check_resolvers(BOUNDS, 100, unknown) == (0, ())
