"""Outputs whose side of the backlash is uncertain to flight software.

The believed side is usually right, and a campaign can confirm it. Friction drags the outputs of a joint to
one side of the backlash. If most of them have the same angle error, this error is an encoder zero or a
backlash width. Outputs that agree with it lie where they are believed to lie. The other outputs may lie
anywhere in their backlash, so their poses carry no information about that joint.

In all functions, `output_jacobian` are screws of the turret frame in its axes per radian of each output,
(6, n, 5). Flags and angles of outputs have shape (5, n).
"""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from marsarm.calibration.campaign_data import MeasuredPoses

REST_SIGMA_RAD: Final = 3e-6
"""Uncertainty of a joint angle at rest, one sigma: encoder and friction. Measured in the closed loop."""
CONSENSUS_SIGMAS: Final = 3.0
"""Largest difference, in sigmas, between two outputs that count as having the same angle error."""
MIN_OUTPUTS: Final = 5
"""Smallest number of outputs that must agree; at least half of all on that side must agree too."""
KNOWN_SIGMAS: Final = 2.0
"""Largest total sigma, as a multiple of the noise, at which the model alone predicts the output.

Such an output needs no agreement with others.
"""


def pose_whitener(measured: MeasuredPoses, output_jacobian: Array, unknown: Flags) -> Array:
    """Compute the matrices, (n, 6, 6), that make error screws independent with unit variance.

    A pose carries no information along the screw of an output whose side is `unknown`: these rows are 0.
    """
    W, A = whiten_joint_jacobian(measured, output_jacobian)
    for pose in np.flatnonzero(unknown.any(axis=0)):
        along = A[pose][:, unknown[:, pose]]
        Q, _ = np.linalg.qr(along, mode="complete")
        W[pose] = Q.T @ W[pose]
        W[pose, : along.shape[1]] = 0.0
    return W


def whiten_joint_jacobian(measured: MeasuredPoses, output_jacobian: Array) -> tuple[Array, Array]:
    """Compute the whitening matrices, (n, 6, 6), for the noise of the tracker and of joints at rest.

    Returns:
        The matrices, and the whitened Jacobian, (n, 6, 5).
    """
    J = np.moveaxis(output_jacobian, 1, 0)
    noise = measured.covariance + REST_SIGMA_RAD**2 * J @ J.swapaxes(1, 2)
    W = np.linalg.inv(np.linalg.cholesky(noise))
    return W, W @ J


def confirm_sides(
    measured: MeasuredPoses,
    output_jacobian: Array,
    error: Array,
    parameter_jacobian: Array,
    covariance: Array,
    uncertain: Flags,
    backlash_rad: Array,
) -> Flags:
    """Find the uncertain outputs that lie where they are believed to lie in their backlash.

    Args:
        error: Screws [rad, m] from the modelled to the measured poses, (6, n).
        parameter_jacobian: Screws of the turret frame per unit of each parameter, (6, n, p).
        covariance: Covariance of the parameters, (p, p).
    """
    joints, n = uncertain.shape
    output_error_rad, noise = np.full((joints, n), np.nan), np.full((joints, n), np.nan)
    output_sensitivity = np.zeros((joints, n, covariance.shape[0]))
    W, A = whiten_joint_jacobian(measured, output_jacobian)
    for pose in np.flatnonzero(uncertain.any(axis=0)):
        affected = uncertain[:, pose]
        a = A[pose][:, affected]
        inverse = np.linalg.inv(a.T @ a)
        to_outputs = inverse @ a.T @ W[pose]
        output_error_rad[affected, pose] = to_outputs @ error[:, pose]
        noise[affected, pose] = np.sqrt(np.diag(inverse))
        output_sensitivity[affected, pose] = to_outputs @ parameter_jacobian[:, pose]
    found = np.zeros_like(uncertain)
    for joint in range(joints):
        for side in (backlash_rad[joint] < 0, backlash_rad[joint] >= 0):
            poses = np.flatnonzero(uncertain[joint] & side)
            B = output_sensitivity[joint, poses]
            errors_rad = output_error_rad[joint, poses]
            found[joint, poses] = find_consensus(errors_rad, noise[joint, poses], B @ covariance @ B.T)
    return found


def find_consensus(error_rad: Array, noise_rad: Array, shared_rad2: Array) -> Flags:
    """Find the outputs, (k,), that agree with the model and with most outputs on the same side.

    Model uncertainty shifts all of them together, so only independent noise separates them.

    Args:
        error_rad: Angles of outputs of one joint that the tracker measures less modelled angles, shape (k,).
        noise_rad: Independent noise of each error, one sigma, shape (k,).
        shared_rad2: Covariance that comes from the uncertainty of the model, shape (k, k).
    """
    if error_rad.size == 0:
        return np.zeros(0, bool)
    shared = np.diag(shared_rad2)
    total = np.sqrt(noise_rad**2 + shared)
    difference_sigma = np.sqrt(np.maximum(total**2 + total[:, None] ** 2 - 2 * shared_rad2, 0.0))
    agree_pairwise = np.abs(error_rad - error_rad[:, None]) <= CONSENSUS_SIGMAS * difference_sigma
    most = agree_pairwise[int(np.argmax(agree_pairwise.sum(axis=1)))]
    # compare with all of them, because the output with most agreement has noise of its own
    most = agree_pairwise[:, most].mean(axis=1) >= 0.5
    enough = most.sum() >= max(MIN_OUTPUTS, 0.5 * most.size)
    agree: Flags = (np.abs(error_rad) < CONSENSUS_SIGMAS * total) & (
        (most & enough) | (total <= KNOWN_SIGMAS * noise_rad)
    )
    return agree
