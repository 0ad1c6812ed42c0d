import numpy as np

from fsw.kinematics.transforms import Pose
from marsarm.calibration.campaign_data import MeasuredPoses

RNG = np.random.default_rng(0)


def test_whitened_noise_has_variance_one():
    n = 20_000
    root = RNG.standard_normal((6, 6))
    measured = MeasuredPoses(Pose(np.zeros((3, 3, n)), np.zeros((3, n))), np.tile(root @ root.T, (n, 1, 1)))
    noise = np.einsum("nij,jk,nk->ni", measured.whitener, root, RNG.standard_normal((n, 6)))
    np.testing.assert_allclose(np.cov(noise.T), np.eye(6), atol=0.05)
