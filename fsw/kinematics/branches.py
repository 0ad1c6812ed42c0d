"""Branches of the inverse kinematics: their names, and the branch of a pose."""

from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import OrthogonalArm
from fsw.kinematics.transforms import Array, Integers

BRANCHES: Final = tuple(
    f"shoulder-{shoulder} elbow-{elbow} wrist-{wrist}"
    for shoulder in ("out", "in")
    for elbow in ("up", "down")
    for wrist in ("up", "down")
)
"""Names of the eight branches, in the order of the slots."""


def fold_distances(s: OrthogonalArm, output_rad: Array) -> Array:
    """Compute signed distances of poses from the folds of shoulder, elbow and wrist.

    A negative value means out, up, up. The shoulder's value is the distance [m] of the turret axis' foot
    behind the azimuth axis. The elbow's value is the sine of its bend, negative above the line from shoulder
    to wrist. The wrist's value is the sine of the turret axis against the approach. The elbow also changes
    its name, without a fold, where the wrist joint passes over or under the elevation joint.

    Args:
        s: Orthogonal arm.
        output_rad: Output angles, shape (5, ...).

    Returns:
        Distances of shoulder [m], elbow and wrist [sine], shape (3, ...).
    """
    q = output_rad + s.theta_rad.reshape(5, *(1,) * (output_rad.ndim - 1))
    upper, fore = q[Joint.ELEVATION], q[Joint.ELEVATION] + q[Joint.ELBOW]
    pitch = fore + q[Joint.WRIST]
    x = s.upper_m * np.cos(upper) + s.fore_m * np.cos(fore)
    ahead = s.out_m + x + s.wrist_m * np.cos(pitch) - s.along_m * np.sin(pitch)
    elbow = np.sin(q[Joint.ELBOW])
    return np.stack([-ahead, np.where(x >= 0, -elbow, elbow), np.cos(q[Joint.TURRET] + s.clock_rad)])


def branch_index(signs: Array) -> Integers:
    """Compute the index of a branch from the signs of its fold distances.

    Args:
        signs: Fold distances, or unitless numbers of the same sign, shape (3, ...).

    Returns:
        Indices into BRANCHES, shape (...).
    """
    index: Integers = (signs >= 0).astype(np.int64).T @ np.array([4, 2, 1])
    return index.T
