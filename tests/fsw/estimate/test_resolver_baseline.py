"""The place of an undecided output by its resolver: what it tells at rest, and how long that holds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.dictionary.commands import MoveJoint, Stop
from fsw.dictionary.enums import Joint
from fsw.estimate.gear import LEAST, LIKELY, MOST
from fsw.estimate.joints import apply_load, locate_at_rest, note_braked, update_joints
from fsw.estimate.resolver_baseline import bound_drift
from tests.fsw.estimate.test_joints import BIAS, CONFIG, HALF, LOADS_NM, resting
from tests.fsw.rig import Rig, quiet_sensors

COUNT = np.array([100, 200, 300, 400, 500])
UNDECIDED = np.array([True, False, False, True, True])
"""Joints that the loads of `resting` leave undecided."""
SLOPE = CONFIG.params.monitors.resolver_error_rad
NOISE_RAD = 5 * np.sqrt(2 / (CONFIG.brake_ticks + 1)) * CONFIG.params.monitors.resolver_noise_rad

five = hnp.arrays(float, 5, elements=st.floats(0, 1))
signed = hnp.arrays(float, 5, elements=st.floats(-1, 1))


def known_here(joints, turn_rad=0.0, error_rad=0.0):
    """Return joints whose sides were last known this far away, with this resolver error."""
    here = replace(
        joints.baseline,
        known_rad=np.zeros(5) + error_rad,
        known_output_rad=joints.output_rad - turn_rad,
    )
    return replace(joints, baseline=here)


def braked(joints, off_rad, cycles=CONFIG.brake_ticks + 1):
    """Return joints after a move has put its brakes on and ended, while the resolvers read this much more."""
    joints = note_braked(joints)
    read = joints.output_rad + BIAS + off_rad
    for _ in range(cycles):
        joints = update_joints(CONFIG, joints, quiet_sensors(COUNT, resolver_rad=read))
    return joints


@given(five, five, signed, st.floats(0, 0.1), st.floats(-5e-3, 5e-3))
def test_an_undecided_output_is_where_its_resolver_has_moved_to_since_its_side_was_known(
    place, before, wrong, turn_rad, bias_rad
):
    """The resolver error changes with the angle, by as much as its monitor bears in a radian."""
    joints, _ = resting()
    joints = known_here(joints, turn_rad, bias_rad)
    least, likely, most = joints.gear_rad.T
    truth = least + place * (most - least)
    # just before the brakes the outputs were elsewhere, and the smoothed error still shows it
    was = least + before * (most - least)
    joints = replace(joints, resolver_error_rad=was - likely + bias_rad)
    bound = NOISE_RAD + SLOPE * turn_rad
    located = locate_at_rest(CONFIG, braked(joints, truth - likely + bias_rad + wrong * SLOPE * turn_rad))
    error = located.gear_rad[:, LIKELY] - truth
    assert (np.abs(error)[UNDECIDED] <= SLOPE * turn_rad + 1e-12).all()
    assert (located.uncertainty_rad[UNDECIDED] <= bound + 1e-12).all()
    assert (located.gear_rad[UNDECIDED, LEAST] <= truth[UNDECIDED] + 1e-12).all()
    assert (truth[UNDECIDED] <= located.gear_rad[UNDECIDED, MOST] + 1e-12).all()
    np.testing.assert_array_equal(located.gear_rad[~UNDECIDED], joints.gear_rad[~UNDECIDED])


def test_the_noise_of_two_means_on_the_brakes_is_within_five_sigma():
    joints, _ = resting()
    assert bound_drift(CONFIG, known_here(joints).baseline, joints.output_rad) == pytest.approx(NOISE_RAD)
    rng, noise_rad = np.random.default_rng(1), CONFIG.params.monitors.resolver_noise_rad
    changes = []
    for _ in range(200):
        joints = note_braked(joints)
        for _ in range(CONFIG.brake_ticks + 1):
            read = joints.output_rad + BIAS + noise_rad * rng.standard_normal(5)
            joints = update_joints(CONFIG, joints, quiet_sensors(COUNT, resolver_rad=read))
        changes.append(locate_at_rest(CONFIG, joints).baseline.known_rad[~UNDECIDED])
    assert np.std(np.diff(changes, axis=0)) == pytest.approx(NOISE_RAD / 5, rel=0.1)


def test_what_the_resolvers_read_where_the_side_is_known_is_noted_and_moves_no_estimate():
    joints, _ = resting()
    located = locate_at_rest(CONFIG, braked(joints, 1e-3))
    np.testing.assert_allclose(located.baseline.known_rad[~UNDECIDED], 1e-3, atol=1e-12)
    noted = located.baseline.known_output_rad
    np.testing.assert_array_equal(noted[~UNDECIDED], joints.output_rad[~UNDECIDED])
    np.testing.assert_array_equal(noted[UNDECIDED], CONFIG.hardstop_rad[UNDECIDED])
    np.testing.assert_array_equal(located.gear_rad[~UNDECIDED], joints.gear_rad[~UNDECIDED])


def test_estimate_and_error_together_stay_what_the_resolvers_read():
    joints, _ = resting()
    joints = braked(known_here(joints), -1e-3)
    located = locate_at_rest(CONFIG, joints)
    assert (located.output_rad != joints.output_rad)[UNDECIDED].all()
    read = joints.output_rad + np.where(UNDECIDED, -1e-3, joints.resolver_error_rad)
    np.testing.assert_allclose(located.output_rad + located.resolver_error_rad, read, atol=1e-15)


def test_a_resolver_does_not_locate_an_output_far_from_where_its_side_was_known_or_before_calibration():
    joints, _ = resting()
    far = braked(known_here(joints, turn_rad=1.0), 1e-3)
    np.testing.assert_array_equal(locate_at_rest(CONFIG, far).gear_rad, far.gear_rad)
    near = braked(known_here(joints), 1e-3)
    none = replace(near.reference, calibrated=np.zeros(5, bool))
    uncalibrated = replace(near, reference=none)
    np.testing.assert_array_equal(locate_at_rest(CONFIG, uncalibrated).gear_rad, near.gear_rad)


def test_a_located_output_stays_until_its_motor_turns_or_its_resolver_reads_something_else():
    joints, _ = resting()
    off_rad = np.where(UNDECIDED, 1.5e-3, 0.0)
    located = locate_at_rest(CONFIG, braked(known_here(joints), off_rad))
    # with this load friction would not hold the outputs there
    pulling_Nm = np.where(UNDECIDED, -2 * CONFIG.output_friction_Nm, LOADS_NM)
    read = located.output_rad + BIAS
    rested = apply_load(CONFIG, located, pulling_Nm)
    rested = update_joints(CONFIG, rested, quiet_sensors(COUNT, resolver_rad=read))
    rested = apply_load(CONFIG, rested, pulling_Nm)
    np.testing.assert_array_equal(rested.gear_rad[UNDECIDED], located.gear_rad[UNDECIDED])
    turned = update_joints(CONFIG, rested, quiet_sensors(COUNT + 1, resolver_rad=read))
    turned = apply_load(CONFIG, turned, pulling_Nm)
    assert (turned.side[UNDECIDED] == -1).all()
    fell = replace(rested, resolver_error_rad=rested.resolver_error_rad - 2 * off_rad)
    assert (apply_load(CONFIG, fell, pulling_Nm).side[UNDECIDED] == -1).all()


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_move_ends_with_its_outputs_located_unless_it_was_stopped(is_stopped):
    """A stopped move may be braked while its motors turn."""
    rig = Rig(CONFIG)
    rig.state = replace(rig.state, joints=known_here(rig.state.joints))
    assert rig.state.joints.uncertainty_rad[Joint.TURRET] > HALF[Joint.TURRET]
    elbow_rad = rig.state.joints.output_rad[Joint.ELBOW]
    rig.until_moving(MoveJoint(Joint.ELBOW, elbow_rad + 0.02))
    rig.run(*([Stop()] if is_stopped else []))
    is_located = rig.state.joints.uncertainty_rad[Joint.TURRET] <= NOISE_RAD + 1e-12
    assert is_located != is_stopped
