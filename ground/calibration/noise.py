"""What a pose tells, and how well: the tracker's noise, that of joints at rest, and gaps of unknown state."""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.calibration.screws import Measured

REST_RAD: Final = 3e-6
"""How well a joint at rest is known, one sigma: encoder, and what friction holds. From the closed loop."""


def whitener_of(measured: Measured, by_joints: Array, unknown: Flags) -> Array:
    """What makes error screws independent and of variance 1, (n, 6, 6).

    `by_joints` (6, n, joints): the screw of the measured frame, in its own axes, per turn of an output. Where
    nobody knows on which side of its gap an output lies (joints, n), the pose tells nothing along its screw:
    such rows are 0.
    """
    W, A = joint_rows(measured, by_joints)
    for pose in np.flatnonzero(unknown.any(axis=0)):
        along = A[pose][:, unknown[:, pose]]
        Q, _ = np.linalg.qr(along, mode="complete")
        W[pose] = Q.T @ W[pose]
        W[pose, : along.shape[1]] = 0.0
    return W


def joint_rows(measured: Measured, by_joints: Array) -> tuple[Array, Array]:
    """The whitener of tracker and joints at rest, (n, 6, 6), and turns of the outputs as it makes them."""
    J = np.moveaxis(by_joints, 1, 0)
    noise = measured.covariance + REST_RAD**2 * J @ J.swapaxes(1, 2)
    W = np.linalg.inv(np.linalg.cholesky(noise))
    return W, W @ J
