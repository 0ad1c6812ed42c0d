"""Planar arm with any number of joints, and synthetic measurements of its tip."""

import numpy as np

from simgap.serial_arm.fit import FitParameter, Linearisation

NOISE_M = 1e-4


class Planar:
    """Planar chain with unknown lengths and joint zeros; the tip is measured in the plane."""

    def __init__(self, rng, joints=3, poses=60, lengths=None, angles=None):
        self.angles = rng.uniform(-2, 2, (joints, poses)) if angles is None else angles
        self.lengths = np.full(joints, 0.5)
        truth = np.zeros(2 * joints) if lengths is None else lengths
        self.tip = self.position(truth) + NOISE_M * rng.standard_normal((2, poses))

    def position(self, x):
        return self._sum(x)[0]

    def _sum(self, x):
        n = len(self.lengths)
        heading = np.cumsum(self.angles + x[n:, None], axis=0)
        along = np.array([np.cos(heading), np.sin(heading)])
        return np.sum((self.lengths + x[:n])[:, None] * along, axis=1), along

    def __call__(self, x):
        n = len(self.lengths)
        p, along = self._sum(x)
        links = (self.lengths + x[:n])[:, None] * along
        beyond = np.cumsum(links[:, ::-1], axis=1)[:, ::-1]
        turned = np.array([-beyond[1], beyond[0]])
        J = np.concatenate([along, turned], axis=1)
        return Linearisation(((p - self.tip) / NOISE_M).T, np.moveaxis(J, 2, 0) / NOISE_M)


def parameters(joints, prior=np.inf):
    lengths = [FitParameter(f"length{k}", "m", 1e-3, prior) for k in range(joints)]
    return lengths + [FitParameter(f"zero{k}", "rad", 1e-3, prior) for k in range(joints)]
