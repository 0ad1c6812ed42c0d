"""Outputs of which flight software does not surely know on which side of their gaps they lie.

What it believes is mostly right. A campaign tells: where the tracker sees most such outputs of a joint,
dragged to one side, off by one and the same angle, that angle is its zero or the width of its gap, and those
that agree with it lie where they are believed to. The others lie somewhere in their gaps, and their poses
tell nothing about that joint.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.calibration.screws import MeasuredPoses

REST_SIGMA_RAD: Final = 3e-6
"""How well a joint at rest is known, one sigma: encoder, and what friction holds. From the closed loop."""


def pose_whitener(measured: MeasuredPoses, by_joints: Array, unknown: Flags) -> Array:
    """What makes error screws independent and of variance 1, (n, 6, 6).

    `by_joints` (6, n, joints): the screw of the measured frame, in its own axes, per turn of an output. Where
    nobody knows on which side of its gap an output lies (joints, n), the pose tells nothing along its screw:
    such rows are 0.
    """
    W, A = whiten_joint_jacobian(measured, by_joints)
    for pose in np.flatnonzero(unknown.any(axis=0)):
        along = A[pose][:, unknown[:, pose]]
        Q, _ = np.linalg.qr(along, mode="complete")
        W[pose] = Q.T @ W[pose]
        W[pose, : along.shape[1]] = 0.0
    return W


def whiten_joint_jacobian(measured: MeasuredPoses, by_joints: Array) -> tuple[Array, Array]:
    """The whitener of tracker and joints at rest, (n, 6, 6), and turns of the outputs as it makes them."""
    J = np.moveaxis(by_joints, 1, 0)
    noise = measured.covariance + REST_SIGMA_RAD**2 * J @ J.swapaxes(1, 2)
    W = np.linalg.inv(np.linalg.cholesky(noise))
    return W, W @ J


CONSENSUS_SIGMAS: Final = 3.0
"""Sigmas within which two outputs are off by the same angle."""
MIN_OUTPUTS: Final = 5
"""Outputs that must agree, and at least half of all on that side."""
KNOWN_SIGMAS: Final = 2.0
"""Where an output is to be is known, whatever others do, if its sigma is at most this many of its noise's."""


@dataclass(frozen=True, slots=True, eq=False)
class OutputErrors:
    """Some outputs of a joint as the tracker sees them."""

    off_rad: Array
    """Beyond where they are modelled to be, (k,)."""
    noise_rad: Array
    """One sigma of each by itself, (k,)."""
    shared_rad2: Array
    """Covariance by what is unsure of the model, (k, k)."""


def confirm_sides(
    measured: MeasuredPoses,
    by_joints: Array,
    error: Array,
    moved: Array,
    covariance: Array,
    unsure: Flags,
    backlash_rad: Array,
) -> Flags:
    """Which of the unsure outputs (joints, n) lie where they are believed to, in their gaps.

    `error` (6, n): screws from the poses modelled with what is believed to the measured ones; `by_joints`
    (6, n, joints) and `moved` (6, n, p): screws of the measured frame per turn of an output and per unit of
    the model's numbers, whose `covariance` is (p, p).
    """
    joints, n = unsure.shape
    off, noise = np.full((joints, n), np.nan), np.full((joints, n), np.nan)
    by_numbers = np.zeros((joints, n, covariance.shape[0]))
    W, A = whiten_joint_jacobian(measured, by_joints)
    for pose in np.flatnonzero(unsure.any(axis=0)):
        which = unsure[:, pose]
        a = A[pose][:, which]
        inverse = np.linalg.inv(a.T @ a)
        turns = inverse @ a.T @ W[pose]
        off[which, pose] = turns @ error[:, pose]
        noise[which, pose] = np.sqrt(np.diag(inverse))
        by_numbers[which, pose] = turns @ moved[:, pose]
    found = np.zeros_like(unsure)
    for joint in range(joints):
        for side in (backlash_rad[joint] < 0, backlash_rad[joint] >= 0):
            where = np.flatnonzero(unsure[joint] & side)
            B = by_numbers[joint, where]
            seen = OutputErrors(off[joint, where], noise[joint, where], B @ covariance @ B.T)
            found[joint, where] = find_consensus(seen)
    return found


def find_consensus(seen: OutputErrors) -> Flags:
    """Those that are where the model has them, and where most others are that were dragged to the same side.

    What is unsure of the model moves them alike: only their own noise keeps them apart.
    """
    if seen.off_rad.size == 0:
        return np.zeros(0, bool)
    shared = np.diag(seen.shared_rad2)
    total = np.sqrt(seen.noise_rad**2 + shared)
    apart = np.sqrt(np.maximum(total**2 + total[:, None] ** 2 - 2 * seen.shared_rad2, 0.0))
    same = np.abs(seen.off_rad - seen.off_rad[:, None]) <= CONSENSUS_SIGMAS * apart
    most = same[int(np.argmax(same.sum(axis=1)))]
    # once more by all of them: the one that most agree with is off by its own noise too
    most = same[:, most].mean(axis=1) >= 0.5
    enough = most.sum() >= max(MIN_OUTPUTS, 0.5 * most.size)
    agree: Flags = (np.abs(seen.off_rad) < CONSENSUS_SIGMAS * total) & (
        (most & enough) | (total <= KNOWN_SIGMAS * seen.noise_rad)
    )
    return agree
