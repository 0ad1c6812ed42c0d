"""Model of a serial arm: its derivatives, first estimate of its setup, calibration, and cross-validation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.marks import slow_but
from helpers.serial_synthetic import POSITION_M, built_arm, drawn_arm, series, setup
from simgap.common.errors import RobotError
from simgap.serial_arm.calibrate import (
    calibrate_series,
    estimate_setup,
    fit_poses,
    held_out_ratio,
    pose_errors,
)
from simgap.serial_arm.chain import Pose
from simgap.serial_arm.model import TERMS, serial_model
from simgap.serial_arm.nested_models import BLOCKS, CrossValidation, temperature_test

NOISE_RMS_M = POSITION_M * np.sqrt(3)


@pytest.mark.parametrize("joints", slow_but([1, 3, 6], 3))
def test_the_derivatives_are_those_of_finite_differences(joints):
    arm = built_arm(drawn_arm(joints), 0)
    model = serial_model(arm, setup(1), series(arm, setup(1), 4, 2), TERMS)
    scale = np.array([min(parameter.scale, 1e-2) for parameter in model.parameters])
    x = scale * np.random.default_rng(3).standard_normal(scale.size)
    steps = 1e-6 * np.eye(scale.size)
    numeric = np.stack([(model(x + h).residual - model(x - h).residual) / 2e-6 for h in steps], -1)
    np.testing.assert_allclose(model(x).jacobian, numeric, rtol=1e-5, atol=1e-5 * np.abs(numeric).max())


@pytest.fixture(scope="module")
def known():
    """Return an arm as drawn and as built, its setup, and its calibration."""
    drawn = drawn_arm()
    built = built_arm(drawn, 5)
    stands = setup(6)
    part = series(built, stands, 500, 7)
    return drawn, built, stands, calibrate_series(drawn, estimate_setup(drawn, part), part, TERMS)


def test_fresh_poses_are_met_to_the_noise(known):
    drawn, built, stands, found = known
    fresh = series(built, stands, 300, 8)
    before = pose_errors(drawn, estimate_setup(drawn, fresh), fresh)
    after = pose_errors(found.arm, found.setup, fresh)
    assert before.rms_m > 10 * NOISE_RMS_M
    assert after.rms_m < 1.15 * NOISE_RMS_M
    assert held_out_ratio(found, fresh) == pytest.approx(1.0, abs=0.1)


def test_what_the_poses_tell_is_found_within_its_sigma(known):
    drawn, built, _, found = known
    fit = found.fit
    names = {parameter.name: k for k, parameter in enumerate(fit.parameters)}
    joints = [f"{one.name}.compliance" for one in drawn.links]
    truth = [one.compliance_rad_per_Nm for one in built.links]
    joints += [f"{one.name}.hysteresis" for one in drawn.links]
    truth += [one.hysteresis_rad for one in built.links]
    joints += [f"{one.name}.cos{k + 1}" for one in drawn.links for k in range(2, 6)]
    truth += [amplitude for one in built.links for amplitude in one.cos_rad[2:6]]
    where = [names[name] for name in joints]
    off = (fit.values[where] - truth) / fit.sigma[where]
    assert np.max(np.abs(off)) < 4.0
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.35)


def test_an_arm_that_was_found_serves_where_it_stands_next(known):
    _, built, _, found = known
    elsewhere = series(built, setup(9), 200, 10)
    moved = calibrate_series(found.arm, estimate_setup(found.arm, elsewhere), elsewhere, ())
    assert pose_errors(moved.arm, moved.setup, elsewhere).rms_m < 1.15 * NOISE_RMS_M
    assert moved.arm == found.arm


def test_joints_say_nothing_of_angles_that_they_did_not_stand_at():
    drawn = drawn_arm(3)
    built = built_arm(drawn, 11)
    stands = setup(12)
    everywhere = series(built, stands, 600, 13)
    part = everywhere.at(np.all(np.abs(everywhere.joint_rad) < 1.5, axis=0))
    found = calibrate_series(drawn, estimate_setup(drawn, part), part, TERMS)
    elsewhere = everywhere.at(np.any(np.abs(everywhere.joint_rad) > 2.0, axis=0))
    assert held_out_ratio(found, elsewhere) < 1.5
    assert pose_errors(found.arm, found.setup, elsewhere).rms_m > 2 * NOISE_RMS_M


def test_poses_that_do_not_belong_are_named_and_left_out(known):
    drawn, built, stands, _ = known
    part = series(built, stands, 200, 14)
    p = part.X_TM.p.copy()
    p[:, 41] += [0.0, 0.05, 0.0]
    p[:, 97] += [0.0, 0.0, 0.001]
    with_outliers = replace(part, X_TM=Pose(part.X_TM.R, p))
    found = calibrate_series(drawn, estimate_setup(drawn, with_outliers), with_outliers, TERMS)
    assert found.outliers == (42, 98)


def test_terms_that_are_not_asked_for_stay_as_they_were(known):
    drawn, built, stands, _ = known
    part = series(built, stands, 100, 15)
    found = calibrate_series(drawn, estimate_setup(drawn, part), part, ("geometry",))
    assert all(one.compliance_rad_per_Nm == 0.0 and one.cos_rad is None for one in found.arm.links)


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_base_and_target_are_exact(seed):
    arm = drawn_arm()
    stands = setup(seed)
    found = estimate_setup(arm, series(arm, stands, 50, seed, noise=0.0))
    for one, other in ((found.X_TB, stands.X_TB), (found.X_FM, stands.X_FM)):
        np.testing.assert_allclose(one.R, other.R, atol=1e-12)
        np.testing.assert_allclose(one.p, other.p, atol=1e-12)


def turned_otherwise(poses):
    """Return poses whose rotations were read in another order."""
    angles = Rotation.from_matrix(np.moveaxis(poses.X_TM.R, -1, 0)).as_euler("XYZ")
    R = np.moveaxis(Rotation.from_euler("ZYX", angles).as_matrix(), 0, -1)
    return replace(poses, X_TM=Pose(R, poses.X_TM.p))


def turned_about_one_axis(poses):
    only_first = poses.joint_rad * (np.arange(len(poses.joint_rad)) == 0)[:, None]
    return replace(poses, joint_rad=only_first)


REFUSED = {
    "few": (lambda poses: poses.at(np.arange(19)), "19 poses are too few; 20 or more are wanted"),
    "alike": (lambda poses: replace(poses.at(np.zeros(100, int)), row=poses.row), "too much alike"),
    "about one axis": (turned_about_one_axis, "second axis"),
    "in mm": (
        lambda poses: replace(poses, X_TM=Pose(poses.X_TM.R, poses.X_TM.p * 1e3)),
        "times as far: see that positions have their unit",
    ),
    "in another order": (turned_otherwise, "rotations the order that the tracker means"),
    "in degrees": (
        lambda poses: replace(poses, joint_rad=np.degrees(poses.joint_rad)),
        "angles have their units",
    ),
}


@pytest.mark.parametrize(("change", "said"), REFUSED.values(), ids=REFUSED)
def test_poses_that_fit_no_arm_are_refused_with_what_may_be_wrong(change, said):
    arm = drawn_arm()
    with pytest.raises(RobotError, match=said):
        estimate_setup(arm, change(series(built_arm(arm, 1), setup(2), 100, 3)))


def test_another_arm_is_refused():
    arm = drawn_arm()
    links = tuple(replace(one, a_m=one.a_m + 0.3) for one in arm.links)
    with pytest.raises(RobotError, match="see that this is the arm of the file"):
        estimate_setup(replace(arm, links=links), series(built_arm(arm, 1), setup(2), 100, 3))


COUNT = 300


def validated(air, moved_m):
    """Cross-validate an arm with air temperature (n,) and target shifts (3, n)."""
    drawn = drawn_arm(3)
    part = series(built_arm(drawn, 1), setup(2), COUNT, 3, air=air)
    part = replace(part, X_TM=Pose(part.X_TM.R, part.X_TM.p + moved_m))
    found = calibrate_series(drawn, estimate_setup(drawn, part), part, TERMS)
    return found, CrossValidation(found.fit, drawn.repeatability.position_m)


def test_a_block_is_predicted_as_by_a_fit_that_never_saw_it():
    found, validation = validated(None, np.zeros((3, COUNT)))
    held_out = validation.held_out()
    part = found.model.series
    for k in range(BLOCKS):
        mine = held_out.block == k
        others = fit_poses(found.model.arm, found.model.setup, part, TERMS, ~mine)
        error = pose_errors(others.arm, others.setup, part.at(mine))
        assert held_out.rms_by_block_m[k] == pytest.approx(error.rms_m, rel=0.01)


def test_a_temperature_that_moves_the_base_explains_something():
    air = 22 + np.sin(np.linspace(0, 9, COUNT)) + 0.3 * np.sin(np.linspace(0, 70, COUNT))
    moved = np.array([[0.0], [0.0], [3 * POSITION_M]]) * (air - 22)
    test = temperature_test(*validated(air, moved))
    assert test.explains
    assert test.gain_m > 3 * test.gain_sigma_m


def test_a_drift_that_a_step_of_the_temperature_resembles_is_left_to_the_clock():
    time = np.linspace(-1, 1, COUNT)
    air = np.where(time > 0.2, 22.1, 21.7)
    drift = np.array([[0.0], [0.0], [3 * POSITION_M]]) * time
    test = temperature_test(*validated(air, drift))
    assert test.gain_m > test.gain_sigma_m
    assert not test.explains
    assert test.placebo == "clock"


def test_without_a_thermometer_nothing_is_said():
    found, validation = validated(None, np.zeros((3, COUNT)))
    assert temperature_test(found, validation) is None


def test_a_temperature_that_stays_the_same_explains_nothing():
    test = temperature_test(*validated(np.full(COUNT, 21.0), np.zeros((3, COUNT))))
    assert not test.explains
    assert test.range_K == 0.0
