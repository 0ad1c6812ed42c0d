"""Forward kinematics, error screws and load torques against their definitions."""

import numpy as np
import pytest
from scipy.linalg import expm

from helpers.serial_synthetic import built_arm, drawn_arm
from simgap.serial_arm import chain


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
    ends, _ = chain.forward_kinematics(chain.repeat_pose(chain.IDENTITY, 7), arm.link_geometry, q)
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
        ends, _ = chain.forward_kinematics(chain.repeat_pose(chain.IDENTITY, 1), arm.link_geometry, angles)
        placed = [chain.Pose(np.eye(3)[:, :, None], one[:, None]) for one in centres]
        heavy = [(X @ one).p[:, 0] for X, one in zip(ends, placed, strict=True)]
        return -sum(m * gravity @ p for m, p in zip(masses, heavy, strict=True))

    ends, axes = chain.forward_kinematics(chain.repeat_pose(chain.IDENTITY, 1), arm.link_geometry, q)
    torque = chain.load_torque_Nm(ends, axes, masses, centres, gravity)[:, 0]
    steps = 1e-6 * np.eye(5)[:, :, None]
    slope = [(energy(q + h) - energy(q - h)) / 2e-6 for h in steps]
    np.testing.assert_allclose(torque, -np.array(slope), atol=1e-7)


RNG = np.random.default_rng(0)


def screw_exp(screw):
    """Return the poses of screws, (6, n), by the exponential of matrices."""
    twist = np.zeros((screw.shape[1], 4, 4))
    twist[:, :3, :3], twist[:, :3, 3] = np.moveaxis(chain.skew(screw[:3]), -1, 0), screw[3:].T
    X = expm(twist)
    return chain.Pose(np.moveaxis(X[:, :3, :3], 0, -1), X[:, :3, 3].T)


@pytest.mark.parametrize("size", [1e-12, 1e-6, 9e-3, 1.1e-2, 0.3, 2.5])
def test_the_logarithm_undoes_the_exponential(size):
    screw = RNG.standard_normal((6, 40))
    screw *= size / np.linalg.norm(screw[:3], axis=0)
    np.testing.assert_allclose(chain.screw_log(screw_exp(screw)), screw, atol=1e-12 * max(1, size), rtol=1e-8)


def poses(n):
    return screw_exp(RNG.standard_normal((6, n)))


def test_the_error_screw_leads_from_the_modelled_to_the_measured_pose():
    modelled, measured = poses(10), poses(10)
    screw = chain.error_screw(modelled, measured)
    np.testing.assert_allclose((modelled @ screw_exp(screw)).R, measured.R, atol=1e-12)
    np.testing.assert_allclose((modelled @ screw_exp(screw)).p, measured.p, atol=1e-12)


def test_derivatives_of_the_whitened_screw_are_exact():
    n = 8
    modelled = poses(n)
    whitener = RNG.standard_normal((n, 6, 6))
    measured = modelled @ screw_exp(0.05 * RNG.standard_normal((6, n)))
    moved = RNG.standard_normal((6, n, 3))
    exact = chain.linearise(modelled, moved, measured, whitener).jacobian
    for k in range(3):
        step = 1e-5
        plus, minus = (
            chain.linearise(
                modelled @ screw_exp(sign * step * moved[:, :, k]), moved, measured, whitener
            ).residual
            for sign in (1, -1)
        )
        np.testing.assert_allclose(exact[:, :, k], (plus - minus) / (2 * step), rtol=1e-5, atol=1e-6)
