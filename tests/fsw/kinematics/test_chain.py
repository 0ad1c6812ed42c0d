"""Forward kinematics of the strained chain, and its Jacobian."""

import numpy as np
import pytest

from fsw.dictionary.joints import Tool
from fsw.kinematics.arm import transform6
from fsw.kinematics.chain import forward, joint_jacobian, spring_pose, tool_pose
from fsw.kinematics.transforms import rotation_x, rotation_y, rotation_z
from tests.fsw.kinematics.test_arm import drawn_interface, drawn_tool, translation, turn
from tests.fsw.rig import config_of, in_limits, matrix

STRAIN = 0.03
ARMS = ["nominal", "calibrated:3"]


def spring(strain) -> np.ndarray:
    """A spring translates, then turns about x, y and z in this order."""
    turns = rotation_x(strain[0]) @ rotation_y(strain[1]) @ rotation_z(strain[2])
    return translation(strain[3:]) @ turn(turns)


def test_the_rigid_arm_is_the_product_of_its_dh_matrices():
    config = config_of()
    for q in in_limits(config, np.random.default_rng(1), 200).T:
        frames = forward(config.arm, q)
        np.testing.assert_allclose(matrix(frames.X_RF[5]), drawn_interface(q), atol=1e-12)
        for tool in Tool:
            np.testing.assert_allclose(
                matrix(tool_pose(config.arm, frames, tool)), drawn_interface(q) @ drawn_tool(tool), atol=1e-12
            )


@pytest.mark.parametrize("name", ARMS)
def test_the_strained_arm_is_the_product_of_links_and_springs(name):
    config, rng = config_of(name), np.random.default_rng(2)
    for q in in_limits(config, rng, 20).T:
        strain = rng.normal(0, STRAIN, (6, 6))
        frames = forward(config.arm, q, strain)
        X = np.eye(4)
        for i, link in enumerate(config.params.links.in_order()):
            about_z = turn(rotation_z(np.array(link.transform.theta_rad)))
            centre = np.array(link.elastic_centre_m)
            rest = np.linalg.inv(about_z) @ matrix(transform6(link.transform))
            X = X @ turn(rotation_z(np.array(0.0 if i == 0 else q[i - 1]))) @ about_z
            np.testing.assert_allclose(matrix(frames.X_RL[i]), X, atol=1e-12)
            X = X @ translation(centre) @ spring(strain[:, i]) @ translation(-centre) @ rest
            np.testing.assert_allclose(matrix(frames.X_RF[i]), X, atol=1e-12)


def test_no_strain_is_zero_strain():
    config = config_of("calibrated:3")
    q = in_limits(config, np.random.default_rng(3), 5)
    rigid_arm, unstrained = forward(config.arm, q), forward(config.arm, q, np.zeros((6, 6, 5)))
    np.testing.assert_allclose(rigid_arm.X_RF.R, unstrained.X_RF.R, atol=1e-15)
    np.testing.assert_allclose(rigid_arm.X_RF.p, unstrained.X_RF.p, atol=1e-15)
    np.testing.assert_array_equal(rigid_arm.X_LD.R[..., 0], np.tile(np.eye(3)[:, :, None], 6))
    np.testing.assert_array_equal(rigid_arm.X_LD.p[..., 0], config.arm.p_LC_m)


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_a_spring_translates_then_turns_about_x_y_and_z(size):
    arm = config_of().arm
    strain = size * np.random.default_rng(4).uniform(-0.03, 0.03, (6, 6, 40))
    X_LD = spring_pose(arm, strain)
    for i in range(6):
        for k in range(40):
            expected = translation(arm.p_LC_m[:, i]) @ spring(strain[:, i, k])
            np.testing.assert_allclose(matrix(X_LD[i, k]), expected, atol=1e-13)


def test_the_order_of_a_spring_s_turns_matters_at_45_mrad():
    """A tenth of a millimetre over a tenth of a metre; the paper's sum of screws would not see it."""
    arm = config_of().arm
    strain = np.zeros((6, 6))
    strain[:3, 2] = 0.045
    R = spring_pose(arm, strain).R[..., 2]
    reverse = rotation_z(np.array(0.045)) @ rotation_y(np.array(0.045)) @ rotation_x(np.array(0.045))
    assert 1e-3 < np.abs(R - reverse).max() < 5e-3


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("tool", Tool)
def test_the_jacobian_agrees_with_finite_differences(name, tool):
    config, rng, h = config_of(name), np.random.default_rng(4), 1e-6
    for q in in_limits(config, rng, 10).T:
        strain = rng.normal(0, STRAIN, (6, 6))

        def pose(angles, strain=strain):
            return tool_pose(config.arm, forward(config.arm, angles, strain), tool)

        X = pose(q)
        J = joint_jacobian(forward(config.arm, q, strain), X.p)
        for joint in range(5):
            e = h * np.eye(5)[joint]
            up, down = pose(q + e), pose(q - e)
            W = (up.R - down.R) / (2 * h) @ X.R.T
            np.testing.assert_allclose(J[:3, joint], [W[2, 1], W[0, 2], W[1, 0]], atol=1e-8)
            np.testing.assert_allclose(J[3:, joint], (up.p - down.p) / (2 * h), atol=1e-8)


def test_a_batch_of_poses_is_its_single_poses():
    config, rng = config_of("calibrated:3"), np.random.default_rng(5)
    q, strain = in_limits(config, rng, 12).reshape(5, 3, 4), rng.normal(0, STRAIN, (6, 6, 3, 4))
    many = forward(config.arm, q, strain)
    X = tool_pose(config.arm, many, Tool.APXS)
    J = joint_jacobian(many, X.p)
    for index in np.ndindex(3, 4):
        one = forward(config.arm, q[:, *index], strain[:, :, *index])
        for name in ("X_RL", "X_LD", "X_RF"):
            several, single = getattr(many, name), getattr(one, name)
            np.testing.assert_allclose(several.R[..., *index], single.R, rtol=0, atol=1e-15)
            np.testing.assert_allclose(several.p[..., *index], single.p, rtol=0, atol=2e-15)
        X_one = tool_pose(config.arm, one, Tool.APXS)
        np.testing.assert_allclose(X.p[:, *index], X_one.p, rtol=0, atol=2e-15)
        np.testing.assert_allclose(J[..., *index], joint_jacobian(one, X_one.p), rtol=0, atol=4e-15)
