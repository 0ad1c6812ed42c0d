"""Forward kinematics of the strained chain, and its Jacobian."""

import numpy as np
import pytest

from fsw.dictionary.joints import Tool
from fsw.kinematics.arm import transform6
from fsw.kinematics.chain import forward, joint_jacobian, strain_transform, tool_pose
from fsw.kinematics.transforms import rigid, rotation_x, rotation_y, rotation_z, translation
from tests.fsw.kinematics.test_arm import drawn_interface, drawn_tool
from tests.fsw.rig import config_of, in_limits

STRAIN = 0.03


def test_the_rigid_arm_is_the_product_of_its_dh_matrices():
    config = config_of()
    for q in in_limits(config, np.random.default_rng(1), 200):
        frames = forward(config.arm, q)
        np.testing.assert_allclose(frames.X_RF[5], drawn_interface(q), atol=1e-12)
        for tool in Tool:
            np.testing.assert_allclose(
                tool_pose(config.arm, frames, tool), drawn_interface(q) @ drawn_tool(tool), atol=1e-12
            )


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
def test_the_strained_arm_is_the_product_of_links_and_springs(name):
    config, rng = config_of(name), np.random.default_rng(2)
    for q in in_limits(config, rng, 20):
        strain = rng.normal(0, STRAIN, (6, 6))
        X = np.eye(4)
        for i, link in enumerate(config.params.links.in_order()):
            turn = rigid(rotation_z(np.array(0.0 if i == 0 else q[i - 1])), np.zeros(3))
            about_z = rigid(rotation_z(np.array(link.transform.theta_rad)), np.zeros(3))
            centre = np.array(link.elastic_centre_m)
            rest = np.linalg.inv(about_z) @ transform6(link.transform)
            X = X @ turn @ about_z @ translation(centre) @ strain_transform(strain[i]) @ translation(-centre)
            X = X @ rest
        np.testing.assert_allclose(forward(config.arm, q, strain).X_RF[5], X, atol=1e-12)


def test_no_strain_is_zero_strain():
    config = config_of("calibrated:3")
    q = in_limits(config, np.random.default_rng(3), 5)
    rigid_arm, unstrained = forward(config.arm, q), forward(config.arm, q, np.zeros((5, 6, 6)))
    np.testing.assert_allclose(rigid_arm.X_RF, unstrained.X_RF, atol=1e-15)
    np.testing.assert_allclose(rigid_arm.X_RD, rigid_arm.X_RC, atol=0)


def test_a_spring_translates_then_turns_about_x_y_and_z():
    s = np.array([0.04, -0.03, 0.02, 0.001, 0.002, -0.003])
    R = rotation_x(s[0]) @ rotation_y(s[1]) @ rotation_z(s[2])
    np.testing.assert_array_equal(strain_transform(s), rigid(R, s[3:]))


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("tool", Tool)
def test_the_jacobian_agrees_with_finite_differences(name, tool):
    config, rng, h = config_of(name), np.random.default_rng(4), 1e-6
    for q in in_limits(config, rng, 10):
        strain = rng.normal(0, STRAIN, (6, 6))

        def pose(angles, strain=strain):
            return tool_pose(config.arm, forward(config.arm, angles, strain), tool)

        X = pose(q)
        J = joint_jacobian(forward(config.arm, q, strain), X[:3, 3])
        for joint in range(5):
            e = h * np.eye(5)[joint]
            D = (pose(q + e) - pose(q - e)) / (2 * h)
            W = D[:3, :3] @ X[:3, :3].T
            np.testing.assert_allclose(J[:3, joint], [W[2, 1], W[0, 2], W[1, 0]], atol=1e-8)
            np.testing.assert_allclose(J[3:, joint], D[:3, 3], atol=1e-8)


def test_a_batch_of_poses_is_its_single_poses():
    config, rng = config_of("calibrated:3"), np.random.default_rng(5)
    q, strain = in_limits(config, rng, 12).reshape(3, 4, 5), rng.normal(0, STRAIN, (3, 4, 6, 6))
    many = forward(config.arm, q, strain)
    p = tool_pose(config.arm, many, Tool.APXS)[..., :3, 3]
    J = joint_jacobian(many, p)
    for index in np.ndindex(3, 4):
        one = forward(config.arm, q[index], strain[index])
        for name in ("X_RC", "X_RD", "X_RF"):
            np.testing.assert_allclose(getattr(many, name)[index], getattr(one, name), atol=1e-15)
        np.testing.assert_allclose(J[index], joint_jacobian(one, p[index]), atol=1e-15)
