import numpy as np
import pytest
from scipy.linalg import expm

from simgap.serial_arm.chain import Pose, error_screw, linearise, screw_log, skew

RNG = np.random.default_rng(0)


def screw_exp(screw):
    """Return the poses of screws, (6, n), by the exponential of matrices."""
    twist = np.zeros((screw.shape[1], 4, 4))
    twist[:, :3, :3], twist[:, :3, 3] = np.moveaxis(skew(screw[:3]), -1, 0), screw[3:].T
    X = expm(twist)
    return Pose(np.moveaxis(X[:, :3, :3], 0, -1), X[:, :3, 3].T)


@pytest.mark.parametrize("size", [1e-12, 1e-6, 9e-3, 1.1e-2, 0.3, 2.5])
def test_the_logarithm_undoes_the_exponential(size):
    screw = RNG.standard_normal((6, 40))
    screw *= size / np.linalg.norm(screw[:3], axis=0)
    np.testing.assert_allclose(screw_log(screw_exp(screw)), screw, atol=1e-12 * max(1, size), rtol=1e-8)


def poses(n):
    return screw_exp(RNG.standard_normal((6, n)))


def test_the_error_screw_leads_from_the_modelled_to_the_measured_pose():
    modelled, measured = poses(10), poses(10)
    screw = error_screw(modelled, measured)
    np.testing.assert_allclose((modelled @ screw_exp(screw)).R, measured.R, atol=1e-12)
    np.testing.assert_allclose((modelled @ screw_exp(screw)).p, measured.p, atol=1e-12)


def test_derivatives_of_the_whitened_screw_are_exact():
    n = 8
    modelled = poses(n)
    whitener = RNG.standard_normal((n, 6, 6))
    measured = modelled @ screw_exp(0.05 * RNG.standard_normal((6, n)))
    moved = RNG.standard_normal((6, n, 3))
    exact = linearise(modelled, moved, measured, whitener).jacobian
    for k in range(3):
        step = 1e-5
        plus, minus = (
            linearise(modelled @ screw_exp(sign * step * moved[:, :, k]), moved, measured, whitener).residual
            for sign in (1, -1)
        )
        np.testing.assert_allclose(exact[:, :, k], (plus - minus) / (2 * step), rtol=1e-5, atol=1e-6)
