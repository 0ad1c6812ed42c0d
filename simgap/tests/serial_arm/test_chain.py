"""Forward kinematics against its definition, and load torques against the potential energy."""

import numpy as np

from helpers.serial_synthetic import built_arm, drawn_arm
from simgap.serial_arm.chain import IDENTITY, Pose, forward_kinematics, load_torque_Nm, repeat_pose


def matrix(six, q):
    """Compute paper equation 1 as the product of six matrices."""
    theta, d, beta, b, alpha, a = six

    def turn(axis, angle):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        X = np.eye(4)
        X[[i, j], [i, j]] = np.cos(angle)
        X[j, i] = np.sin(angle)
        X[i, j] = -X[j, i]
        return X

    def shift(axis, length):
        X = np.eye(4)
        X[axis, 3] = length
        return X

    return turn(2, q + theta) @ shift(2, d) @ turn(1, beta) @ shift(1, b) @ turn(0, alpha) @ shift(0, a)


def test_the_chain_is_the_product_of_the_paper_s_link_transforms():
    arm = built_arm(drawn_arm(5), 3)
    q = np.random.default_rng(0).uniform(-3, 3, (5, 7))
    ends, _ = forward_kinematics(repeat_pose(IDENTITY, 7), arm.link_geometry, q)
    for n in range(7):
        X = np.eye(4)
        for six, turn, end in zip(arm.link_geometry, q[:, n], ends, strict=True):
            X = X @ matrix(six, turn)
            np.testing.assert_allclose(end.R[:, :, n], X[:3, :3], atol=1e-14)
            np.testing.assert_allclose(end.p[:, n], X[:3, 3], atol=1e-14)


def test_the_load_is_the_slope_of_the_energy():
    arm = built_arm(drawn_arm(5), 4)
    masses = np.array([one.mass_kg for one in arm.links])
    centres = np.array([one.mass_centre_m for one in arm.links])
    gravity = np.array([1.0, 2.0, -9.0])
    q = np.random.default_rng(1).uniform(-3, 3, (5, 1))

    def energy(angles):
        ends, _ = forward_kinematics(repeat_pose(IDENTITY, 1), arm.link_geometry, angles)
        heavy = [
            (X @ Pose(np.eye(3)[:, :, None], c[:, None])).p[:, 0] for X, c in zip(ends, centres, strict=True)
        ]
        return -sum(m * gravity @ p for m, p in zip(masses, heavy, strict=True))

    ends, axes = forward_kinematics(repeat_pose(IDENTITY, 1), arm.link_geometry, q)
    torque = load_torque_Nm(ends, axes, masses, centres, gravity)[:, 0]
    steps = 1e-6 * np.eye(5)[:, :, None]
    slope = [(energy(q + h) - energy(q - h)) / 2e-6 for h in steps]
    np.testing.assert_allclose(torque, -np.array(slope), atol=1e-7)
