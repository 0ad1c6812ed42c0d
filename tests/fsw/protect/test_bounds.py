"""Bounds follow from the parameters, for any of them."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import CYCLE_S
from fsw.protect.inputs import compute_bounds
from tests.fsw.protect.lab import CONFIG, JOINTS, MONITORS, PARAMS, STIFFNESS

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
    preload = replace(PARAMS.preload, step_N=7.0, error_share=0.125)
    bounds = compute_bounds(replace(PARAMS, preload=preload), CONFIG.arm, CYCLE_S)
    assert (bounds.press_step_N, bounds.press_error_share) == (7.0, 0.125)
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
