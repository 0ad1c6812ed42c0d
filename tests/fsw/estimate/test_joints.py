"""The estimate of the joints from encoders and resolvers, before and after calibration."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.estimate.gear import LIKELY
from fsw.estimate.joints import (
    apply_calibration,
    apply_load,
    uninitialised_estimate,
    update_joints,
)
from fsw.estimate.reference import HardstopFit, Reference, forget_joint, no_reference
from fsw.estimate.resolver_baseline import RESOLVER_FILTER_S
from tests.fsw.rig import MARS_R_m_s2, config_of, quiet_sensors

CONFIG = config_of()
HALF = CONFIG.half_backlash_rad
ZERO = np.array([0.1, -1.0, 1.5, 2.0, 1.0])
BIAS = np.array([1e-3, -2e-3, 0.0, 3e-3, -1e-3])
LOADS_NM = np.array([0.0, -150.0, -60.0, -2.0, 1.0])
REMEMBERED = Reference(np.ones(5, bool), np.ones(5, bool), ZERO, 0.9 * HALF, BIAS, np.full(5, 170.0))

counts = hnp.arrays(np.int64, 5, elements=st.integers(-(10**7), 10**7))


def first_update(count, reference=REMEMBERED, **readings):
    return update_joints(CONFIG, uninitialised_estimate(CONFIG, reference), quiet_sensors(count, **readings))


def resting(count=(100, 200, 300, 400, 500), reference=REMEMBERED):
    """Return joints under a load, and their sensor readings."""
    joints = apply_load(CONFIG, first_update(np.array(count), reference), LOADS_NM)
    sensors = quiet_sensors(count, resolver_rad=joints.output_rad + BIAS)
    return joints, sensors


def calibrated(joints, joint, off_rad=0.0, share=1.0):
    """Return joints after one found its hardstop off its drawing, and a share of its backlash."""
    stop = CONFIG.params.joints.in_order()[joint].hardstop_rad
    found = HardstopFit(stop + off_rad, 30.0, 1.5e-5, share * HALF[joint], backlash_measured=True)
    return apply_calibration(CONFIG, joints, LOADS_NM, joint, found)


@given(counts)
def test_a_calibrated_joint_is_where_its_encoder_and_its_zero_say(count):
    joints = first_update(count, resolver_rad=np.full(5, 9.0))
    assert joints.initialised
    np.testing.assert_array_equal(joints.motor_rad, count * CONFIG.rad_per_count + ZERO)
    np.testing.assert_array_equal(joints.motor_rate_rad_s, 0)
    again = update_joints(CONFIG, joints, quiet_sensors(count))
    np.testing.assert_array_equal(again.motor_rad, joints.motor_rad)
    np.testing.assert_array_equal(again.motor_rate_rad_s, 0)


@given(counts, counts)
def test_a_joint_that_is_not_calibrated_is_where_its_resolver_said_at_first_and_the_motion_since(
    count, moved
):
    read = np.array([0.2, -0.4, 0.6, -0.8, 1.0])
    joints = first_update(count, no_reference(CONFIG), resolver_rad=read)
    np.testing.assert_allclose(joints.motor_rad, read, atol=1e-11)
    joints = update_joints(CONFIG, joints, quiet_sensors(count + moved, resolver_rad=np.full(5, 9.0)))
    np.testing.assert_allclose(joints.motor_rad, read + moved * CONFIG.rad_per_count, atol=1e-11)
    assert not joints.reference.calibrated.any()


@pytest.mark.parametrize("joint", Joint)
def test_what_is_remembered_of_a_joint_is_used_and_kept_for_comparison_when_it_no_longer_counts(joint):
    count, this = np.array([100, 200, 300, 400, 500]), np.arange(5) == joint
    joints = first_update(count, forget_joint(REMEMBERED, joint))
    np.testing.assert_array_equal(joints.reference.calibrated, ~this)
    assert joints.reference.known.all()
    np.testing.assert_allclose(joints.motor_rad, count * CONFIG.rad_per_count + ZERO, atol=1e-15)


def test_one_count_is_one_step_of_the_motor_over_the_gear_ratio():
    count = np.array([10, -20, 30, -40, 50])
    before = first_update(count)
    joints = update_joints(CONFIG, before, quiet_sensors(count + 1))
    step = 2 * np.pi / 256 / np.array([7520, 7520, 7520, 4624, 4624])
    np.testing.assert_allclose(joints.motor_rad - before.motor_rad, step, atol=1e-15)
    np.testing.assert_allclose(joints.motor_rate_rad_s, step * CYCLE_HZ, atol=1e-12)


def test_the_likely_output_is_the_motor_with_its_likely_gear_angle():
    joints, _ = resting()
    np.testing.assert_array_equal(joints.output_rad, joints.motor_rad + joints.gear_rad[:, LIKELY])
    np.testing.assert_array_equal(joints.side, [0, -1, -1, 0, 0])
    np.testing.assert_allclose(joints.backlash_state[0], 0.9 * HALF * joints.side)
    stiffness = CONFIG.arm.gear_stiffness_Nm_rad
    known = joints.side != 0
    unknown_Nm = CONFIG.load_error_Nm + 2 * CONFIG.output_friction_Nm
    np.testing.assert_allclose(joints.uncertainty_rad[known], (unknown_Nm / stiffness)[known])
    assert (joints.uncertainty_rad[~known] > 0.8 * HALF[~known]).all()


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("off_rad", [-4e-3, 4e-3])
def test_after_its_calibration_a_joint_met_its_hardstop_where_the_drawing_has_it(joint, off_rad):
    """The new zero changes the angle at which the output met its stop by `off_rad`."""
    before, sensors = resting()
    after = calibrated(before, joint, off_rad, 1.1)
    this = np.arange(5) == joint
    np.testing.assert_allclose(after.motor_rad - before.motor_rad, np.where(this, -off_rad, 0.0), atol=1e-12)
    np.testing.assert_array_equal(after.reference.half_backlash_rad, np.where(this, 1.1 * HALF, 0.9 * HALF))
    np.testing.assert_array_equal(after.gear_rad[~this], before.gear_rad[~this])
    np.testing.assert_array_equal(after.reference.zero_rad[~this], ZERO[~this])
    next_one = update_joints(CONFIG, after, sensors)
    np.testing.assert_allclose(next_one.motor_rad, after.motor_rad, atol=1e-12)
    np.testing.assert_allclose(next_one.motor_rate_rad_s, 0, atol=1e-9)
    # the gear has just dragged the joint off its stop
    np.testing.assert_array_equal(next_one.gear_rad[joint], after.bounds.lowest_rad[joint])
    first_time, _ = resting(reference=no_reference(CONFIG))
    np.testing.assert_array_equal(calibrated(first_time, joint).reference.calibrated, this)


@pytest.mark.parametrize("joint", Joint)
def test_a_calibration_learns_the_bias_of_its_resolver_from_what_it_reads(joint):
    joints, sensors = resting()
    sensors = replace(sensors, resolver_rad=sensors.resolver_rad + 1e-3)
    for _ in range(10 * CYCLE_HZ):
        joints = update_joints(CONFIG, joints, sensors)
    np.testing.assert_allclose(joints.resolver_error_rad, 1e-3, atol=1e-9)
    joints = calibrated(joints, joint, 2e-3)
    for _ in range(10 * CYCLE_HZ):
        joints = update_joints(CONFIG, joints, sensors)
    expected = np.where(np.arange(5) == joint, 0.0, 1e-3)
    np.testing.assert_allclose(joints.resolver_error_rad, expected, atol=1e-9)
    learned = sensors.resolver_rad[joint] - joints.output_rad[joint]
    assert joints.reference.resolver_bias_rad[joint] == pytest.approx(learned, abs=1e-9)


def test_the_resolver_error_is_smoothed():
    joints, sensors = resting()
    wrong = replace(sensors, resolver_rad=sensors.resolver_rad + 0.01)
    for _ in range(round(RESOLVER_FILTER_S * CYCLE_HZ)):
        joints = update_joints(CONFIG, joints, wrong)
    np.testing.assert_allclose(joints.resolver_error_rad, 0.01 * (1 - np.exp(-1)), rtol=0.03)


def test_gravity_is_as_first_read_and_then_filtered():
    count = np.zeros(5, int)
    joints = first_update(count, gravity_R_m_s2=[1, 2, 3])
    np.testing.assert_array_equal(joints.gravity_R_m_s2, [1, 2, 3])
    joints = first_update(count)
    tilted = np.array([0.5, 0.0, 3.68])
    for _ in range(CYCLE_HZ):
        joints = update_joints(CONFIG, joints, quiet_sensors(count, gravity_R_m_s2=tilted))
    share = (joints.gravity_R_m_s2[0] - MARS_R_m_s2[0]) / 0.5
    assert abs(share - (1 - np.exp(-1))) < 0.01
