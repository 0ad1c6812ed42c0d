"""The estimate of the joints: encoder zero, rates, and the play operator of the backlash."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import SetReference
from fsw.estimate.joints import (
    STILL_RAD,
    gap_after,
    gap_to_move,
    load_side,
    set_reference,
    unreferenced,
    update,
)
from tests.fsw.rig import MARS_R_m_s2, config_of, quiet_sensors

CONFIG = config_of()
HALF = CONFIG.half_gap_rad

sides = hnp.arrays(float, 5, elements=st.sampled_from([-1.0, 0.0, 1.0]))
motions = hnp.arrays(float, 5, elements=st.floats(-0.01, 0.01))
gaps = hnp.arrays(float, 5, elements=st.floats(-1, 1)).map(lambda share: share * HALF)
torques = hnp.arrays(float, 5, elements=st.floats(-200, 200))


@given(sides, gaps, motions)
def test_the_output_never_leaves_its_gap(side, gap, motion):
    assert (np.abs(gap_after(CONFIG, side, gap, motion)) <= HALF).all()


@given(sides, gaps, motions)
def test_a_motor_that_stands_changes_nothing_twice(side, gap, motion):
    once = gap_after(CONFIG, side, gap, motion)
    np.testing.assert_array_equal(gap_after(CONFIG, side, once, np.zeros(5)), once)


@given(sides, gaps, motions)
def test_a_load_beyond_friction_holds_the_output_on_its_flank(side, gap, motion):
    after = gap_after(CONFIG, side, gap, motion)
    loaded = side != 0
    np.testing.assert_array_equal(after[loaded], (side * HALF)[loaded])


@given(gaps, motions)
def test_inside_the_gap_the_output_stands_still(gap, motion):
    after = gap_after(CONFIG, np.zeros(5), gap, motion)
    inside = np.abs(gap - motion) < HALF
    np.testing.assert_allclose((after + motion)[inside], gap[inside], atol=1e-15)


@given(gaps, st.floats(0, 0.005), st.floats(0, 0.005))
def test_a_motion_in_one_direction_may_be_taken_in_parts(gap, first, second):
    free = np.zeros(5)
    for sign in (1.0, -1.0):
        parts = gap_after(
            CONFIG, free, gap_after(CONFIG, free, gap, np.full(5, sign * first)), np.full(5, sign * second)
        )
        whole = gap_after(CONFIG, free, gap, np.full(5, sign * (first + second)))
        np.testing.assert_allclose(parts, whole, atol=1e-15)


def test_a_long_motion_drags_the_output_on_the_rear_flank():
    for direction in (1.0, -1.0):
        after = gap_after(CONFIG, np.zeros(5), np.zeros(5), np.full(5, 0.1 * direction))
        np.testing.assert_array_equal(after, -direction * HALF)


@given(torques, gaps, motions)
def test_the_gap_to_plan_for_is_what_a_motor_that_far_leaves(torque, gap, motion):
    """Where the output is to move, the planned gap is where the play operator ends up."""
    planned = gap_to_move(CONFIG, torque, gap, motion)
    assert (np.abs(planned) <= HALF).all()
    moved = np.abs(motion) > STILL_RAD
    motor = motion - (planned - gap)
    reached = gap_after(CONFIG, load_side(CONFIG, torque), gap, motor)
    np.testing.assert_allclose(reached[moved], planned[moved], atol=1e-15)


@given(torques, gaps)
def test_an_output_that_is_not_to_move_stays_where_it_lies_unless_loaded(torque, gap):
    planned = gap_to_move(CONFIG, torque, gap, np.zeros(5))
    free = np.abs(torque) <= CONFIG.output_friction_Nm
    np.testing.assert_array_equal(planned[free], gap[free])
    np.testing.assert_array_equal(planned[~free], (np.sign(torque) * HALF)[~free])


@given(torques)
def test_only_a_torque_beyond_friction_has_a_side(torque):
    expected = np.where(np.abs(torque) > CONFIG.output_friction_Nm, np.sign(torque), 0)
    np.testing.assert_array_equal(load_side(CONFIG, torque), expected)


def referenced(count, told=(0.1, -1.0, 1.5, 2.0, 1.0), side=(1, 1, -1, 0, -1)):
    first = update(CONFIG, unreferenced(5), quiet_sensors(count))
    return set_reference(CONFIG, first, SetReference(told, side))


@given(hnp.arrays(np.int64, 5, elements=st.integers(-(10**7), 10**7)))
def test_after_a_reference_the_joint_is_where_it_was_told_to_be(count):
    told = (0.1, -1.0, 1.5, 2.0, 1.0)
    joints = referenced(count, told)
    assert joints.referenced
    np.testing.assert_array_equal(joints.motor_rad, told)
    np.testing.assert_array_equal(joints.gap_rad, HALF * np.array([1, 1, -1, 0, -1]))
    again = update(CONFIG, joints, quiet_sensors(count))
    np.testing.assert_allclose(again.motor_rad, told, atol=1e-12)
    np.testing.assert_allclose(again.motor_rate_rad_s, 0, atol=1e-10)


def test_one_count_is_one_step_of_the_motor_over_the_gear_ratio():
    start = np.array([10, -20, 30, -40, 50])
    joints = update(CONFIG, referenced(start), quiet_sensors(start + 1))
    step = 2 * np.pi / 256 / np.array([7520, 7520, 7520, 4624, 4624])
    np.testing.assert_allclose(joints.motor_rad - (0.1, -1.0, 1.5, 2.0, 1.0), step, atol=1e-15)
    np.testing.assert_allclose(joints.motor_rate_rad_s, step * CYCLE_HZ, atol=1e-12)


def test_a_second_reference_replaces_the_first():
    count = np.array([100, 200, 300, 400, 500])
    joints = referenced(count)
    joints = update(CONFIG, joints, quiet_sensors(count + 1000))
    joints = set_reference(CONFIG, joints, SetReference((0.0, 0.0, 0.0, 0.0, 0.0), (0, 0, 0, 0, 0)))
    joints = update(CONFIG, joints, quiet_sensors(count + 1000))
    np.testing.assert_allclose(joints.motor_rad, 0, atol=1e-12)


def test_before_a_reference_gravity_is_as_read_and_after_it_filtered():
    count = np.zeros(5, int)
    raw = update(CONFIG, unreferenced(5), quiet_sensors(count, gravity_R_m_s2=[1, 2, 3]))
    np.testing.assert_array_equal(raw.gravity_R_m_s2, [1, 2, 3])
    joints = replace(referenced(count), gravity_R_m_s2=MARS_R_m_s2)
    tilted = np.array([0.5, 0.0, 3.68])
    for _ in range(CYCLE_HZ):
        joints = update(CONFIG, joints, quiet_sensors(count, gravity_R_m_s2=tilted))
    share = (joints.gravity_R_m_s2[0] - MARS_R_m_s2[0]) / 0.5
    assert abs(share - (1 - np.exp(-1))) < 0.01
