"""Poses and rotations in batches: components lead, the batch axis trails.

A vector has shape (3, n), a rotation (3, 3, n), so that the inner loops of numpy run over the batch.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simgap.arrays import Array, Flags, Integers


class AnyPose(Protocol):
    """Pose of any class, which has a rotation and a position."""

    @property
    def R(self) -> Array:
        """Rotation, (3, 3, ...)."""

    @property
    def p(self) -> Array:
        """Position [m], (3, ...)."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Pose of a frame: X_AB holds R_AB and the position of B in A."""

    R: Array
    """Rotation, (3, 3, ...)."""
    p: Array
    """Position in metres, (3, ...)."""

    def __matmul__(self, other: "Pose") -> "Pose":
        """Return X_AC = X_AB @ X_BC; batches broadcast."""
        return Pose(compose(self.R, other.R), rotate(self.R, other.p) + self.p)

    def __getitem__(self, index: int | slice | Flags | Integers) -> "Pose":
        """Return the poses at an index of the batch axis."""
        return Pose(self.R[:, :, index], self.p[:, index])


IDENTITY = Pose(np.eye(3), np.zeros(3))


def repeat_pose(X: Pose, n: int) -> Pose:
    """Repeat a pose.

    Args:
        X: A single pose.
        n: Number of copies.

    Returns:
        The pose as a batch (n,).
    """
    return Pose(np.repeat(X.R[:, :, None], n, axis=2), np.repeat(X.p[:, None], n, axis=1))


def relative_pose(X_AB: AnyPose, X_AC: AnyPose) -> Pose:
    """Compute the pose of one frame in another.

    Args:
        X_AB: Frame B, batch (n,).
        X_AC: Frame C in the same frame, batch (n,).

    Returns:
        X_BC, batch (n,).
    """
    R_BA = np.swapaxes(X_AB.R, 0, 1)
    return Pose(R_BA, -rotate_back(X_AB.R, X_AB.p)) @ Pose(X_AC.R, X_AC.p)


def compose(R: Array, S: Array) -> Array:
    """Multiply rotations.

    Args:
        R: Left rotations, shape (3, 3, ...), unitless.
        S: Right rotations, shape (3, 3, ...), unitless.

    Returns:
        The rotations R S, shape (3, 3, ...).
    """
    product: Array = np.einsum("ik...,kj...->ij...", R, S)
    return product


def rotate(R: Array, v: Array) -> Array:
    """Rotate vectors.

    Args:
        R: Matrices of rotations, shape (3, 3, ...).
        v: Vectors of any unit, shape (3, ...).

    Returns:
        The vectors R v, shape (3, ...), unit of v.
    """
    turned: Array = np.einsum("ij...,j...->i...", R, v)
    return turned


def rotate_back(R: Array, v: Array) -> Array:
    """Rotate vectors by the transposes of rotations.

    Args:
        R: Matrices of rotations, shape (3, 3, ...).
        v: Vectors of any unit, shape (3, ...).

    Returns:
        The vectors R^T v, shape (3, ...), unit of v.
    """
    turned: Array = np.einsum("ji...,j...->i...", R, v)
    return turned


def norm(v: Array) -> Array:
    """Compute the Euclidean norm of vectors.

    Args:
        v: Vectors of any unit, shape (3, n).

    Returns:
        The norms, shape (n,), unit of v.
    """
    lengths: Array = np.sqrt(np.einsum("in,in->n", v, v))
    return lengths


def skew(v: Array) -> Array:
    """Build the matrices [v] of the vector product: [v] w = v x w.

    Args:
        v: Vectors of any unit, shape (3, n).

    Returns:
        The matrices, shape (3, 3, n), unit of v.
    """
    K = np.zeros((3, *v.shape))
    K[0, 1], K[0, 2], K[1, 2] = -v[2], v[1], -v[0]
    K[1, 0], K[2, 0], K[2, 1] = v[2], -v[1], v[0]
    return K
