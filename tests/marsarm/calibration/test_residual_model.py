"""Model of the deflected arm: exact derivatives, and equality with flight parameters."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import build_arm
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import gravity_direction
from marsarm.calibration.arm_parameters import (
    BACKLASHES,
    ENCODER_ZEROS,
    arm_parameters,
    move_zeros_to_hardstops,
    params_with_values,
)
from marsarm.calibration.residual_model import joint_jacobian, predict_poses, residual_model, settle_poses
from sim.effects.structure import StandInTurret
from simgap.serial_arm.chain import error_screw
from tests.marsarm.calibration.lab import NOMINAL, campaign

PARAMETERS = arm_parameters()
SCALE = np.array([parameter.scale for parameter in PARAMETERS])

ROUNDING = 1e-6
"""Rounding of whitened residuals: the equilibrium is found to 1e-11, the noise is 1e-5."""


def some_numbers(seed: int):
    return SCALE * np.random.default_rng(seed).standard_normal(SCALE.size)


@pytest.fixture(scope="module")
def model():
    poses = campaign().at(np.arange(0, 160, 8))
    return residual_model(NOMINAL, poses)


@pytest.mark.slow
def test_derivatives_are_those_of_finite_differences(model):
    x = some_numbers(0)
    exact = model(x).jacobian
    for k, parameter in enumerate(PARAMETERS):
        step = np.zeros(SCALE.size)
        step[k] = 1e-3 * SCALE[k]
        numeric = (model(x + step).residual - model(x - step).residual) / (2 * step[k])
        off, size = np.abs(numeric - exact[..., k]).max(), np.abs(numeric).max()
        assert off < 2e-6 * size + ROUNDING / step[k], parameter.name


def test_turns_of_the_outputs_move_the_turret_as_other_motor_angles_do(model):
    x, believed = some_numbers(1), model.believed
    jacobian = joint_jacobian(settle_poses(NOMINAL, x, believed))
    step = 1e-5
    for joint in Joint:
        turn = step * (np.arange(5) == joint)[:, None]
        turned = (replace(believed, motor_rad=believed.motor_rad + by_rad) for by_rad in (-turn, turn))
        X, Y = (predict_poses(NOMINAL, x, one) for one in turned)
        numeric = error_screw(X, Y) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, joint], numeric, atol=1e-5)


def test_the_arm_of_the_model_is_the_arm_of_the_parameter_file(model):
    x, believed = some_numbers(4), model.believed
    x[36:42] = 0.0
    X = predict_poses(NOMINAL, x, believed)
    for kg in (8.0, 19.0):
        where = np.flatnonzero(believed.turret_kg == kg)
        arm = build_arm(StandInTurret(kg).on_params(params_with_values(NOMINAL, x)))
        at = believed.at(where)
        wound_rad = at.friction_Nm / arm.gear_stiffness_Nm_rad[:, None]
        backlash_rad = at.backlash_rad * np.exp(x[BACKLASHES])[:, None] - wound_rad
        frames = settle(arm, at.motor_rad, backlash_rad, at.gravity_R_m_s2).frames
        np.testing.assert_allclose(frames.X_RF.p[:, 5], X.p[:, where], atol=2e-6)
        np.testing.assert_allclose(frames.X_RF.R[:, :, 5], X.R[:, :, where], atol=2e-6)


def test_without_any_difference_the_arm_is_the_drawing():
    assert params_with_values(NOMINAL, np.zeros(SCALE.size)) == NOMINAL or np.allclose(
        build_arm(params_with_values(NOMINAL, np.zeros(SCALE.size))).RP_CF,
        build_arm(NOMINAL).RP_CF,
        atol=1e-15,
    )


def test_zeros_in_the_hardstops_are_the_same_arm_at_angles_that_are_so_much_larger():
    x = some_numbers(2)
    zero, shifted = move_zeros_to_hardstops(NOMINAL, x)
    np.testing.assert_array_equal(zero, x[list(ENCODER_ZEROS)])
    motor = np.random.default_rng(3).uniform(-1, 1, (5, 40))
    gravity, backlash_rad = 9.81 * gravity_direction(0.3, 0.1), 1e-3 * np.ones((5, 1))
    one = settle(build_arm(params_with_values(NOMINAL, x)), motor, backlash_rad, gravity).frames.X_RF
    other = settle(build_arm(shifted), motor + zero[:, None], backlash_rad, gravity).frames.X_RF
    np.testing.assert_allclose(one.p[:, 5], other.p[:, 5], atol=1e-6)
    np.testing.assert_allclose(one.R[:, :, 5], other.R[:, :, 5], atol=1e-6)
    for joint, new, old in zip(Joint, shifted.joints.in_order(), NOMINAL.joints.in_order(), strict=True):
        assert new.hardstop_rad - old.hardstop_rad == pytest.approx(zero[joint])


def test_a_pose_whose_gap_nobody_knows_tells_nothing_along_that_joint(model):
    unknown = campaign().believed.side[:, ::8] == 0
    counted = model(np.zeros(SCALE.size)).is_informative
    np.testing.assert_array_equal(6 - counted.sum(axis=1), unknown.sum(axis=0))
    elsewhere = np.where(unknown, -model.believed.backlash_rad, model.believed.backlash_rad)
    shifted = replace(model, believed=replace(model.believed, backlash_rad=elsewhere))
    off = shifted(np.zeros(SCALE.size)).residual - model(np.zeros(SCALE.size)).residual
    # a backlash of 4 mrad would show as 40 sigma; the remainder is of second order
    assert np.abs(off).max() < 1.0
