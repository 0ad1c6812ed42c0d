"""Outputs of which flight software does not surely know on which side of their gaps they lie.

What it believes is mostly right. A campaign tells: where the tracker sees most such outputs of a joint off by
one and the same angle, that angle is its zero, and those that agree with it lie where they are believed
to. The others lie somewhere in their gaps, and their poses tell nothing about that joint.
"""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.calibration.noise import joint_rows
from ground.calibration.screws import Measured

AGREE: Final = 3.0
"""Sigmas within which two outputs are off by the same angle."""
FEWEST: Final = 5
"""Outputs that must agree, and at least half of all."""


def agreeing(measured: Measured, by_joints: Array, error: Array, unsure: Flags, width_rad: Array) -> Flags:
    """Which of the unsure outputs (joints, n) lie where they are believed to.

    `error` (6, n): screws from the poses modelled with what is believed to the measured ones; `by_joints`
    (6, n, joints): screws of the measured frame per turn of an output; `width_rad` (joints, n): how well the
    places in the gaps are known where the side is, one sigma.
    """
    off, sigma = np.full(unsure.shape, np.nan), np.full(unsure.shape, np.nan)
    W, A = joint_rows(measured, by_joints)
    for pose in np.flatnonzero(unsure.any(axis=0)):
        joints = unsure[:, pose]
        a = A[pose][:, joints]
        covariance = np.linalg.inv(a.T @ a)
        off[joints, pose] = covariance @ a.T @ W[pose] @ error[:, pose]
        sigma[joints, pose] = np.hypot(np.sqrt(np.diag(covariance)), width_rad[joints, pose])
    found = np.zeros_like(unsure)
    for joint in range(len(unsure)):
        where = np.flatnonzero(unsure[joint])
        found[joint, where] = _majority(off[joint, where], sigma[joint, where])
    return found


def _majority(off: Array, sigma: Array) -> Flags:
    """Those that agree with the one that most agree with; none if they are too few."""
    if off.size == 0:
        return np.zeros(0, bool)
    together = np.hypot(sigma, sigma[:, None])
    same = np.abs(off - off[:, None]) < AGREE * together
    best = same[int(np.argmax(same.sum(axis=1)))]
    # once more about their mean: the one is off by its own noise too
    middle = np.average(off[best], weights=sigma[best] ** -2)
    agree: Flags = np.abs(off - middle) < AGREE * sigma
    return agree if agree.sum() >= max(FEWEST, 0.5 * off.size) else np.zeros_like(agree)
