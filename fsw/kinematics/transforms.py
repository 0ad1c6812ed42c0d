"""Rotations, poses and screws, for one or for many: components lead, batch axes trail.

A vector is (3, ...), a rotation (3, 3, ...), a screw (6, ...) with the rotation first. The same code serves a
single pose and a million: with components leading, numpy's inner loops run over the batch.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where a frame is: X_AB holds R_AB and the position of B in A."""

    R: Array
    """(3, 3, ...)."""
    p: Array
    """(3, ...), metres."""

    def __matmul__(self, other: "Pose") -> "Pose":
        """X_AC = X_AB @ X_BC, in any batch that broadcasts."""
        return Pose(compose(self.R, other.R), rotate(self.R, other.p) + self.p)

    def __getitem__(self, index: object) -> "Pose":
        """The poses at an index of the batch axes."""
        where = index if isinstance(index, tuple) else (index,)
        return Pose(self.R[(slice(None), slice(None), *where)], self.p[(slice(None), *where)])


def stack_poses(poses: Sequence[Pose]) -> Pose:
    """One or more poses as one, along a new last axis."""
    return Pose(np.stack([X.R for X in poses], -1), np.stack([X.p for X in poses], -1))


IDENTITY = Pose(np.eye(3), np.zeros(3))


def compose(R: Array, S: Array) -> Array:
    """The product of rotations (3, 3, ...)."""
    product: Array = np.einsum("ik...,kj...->ij...", R, S)
    return product


def rotate(R: Array, v: Array) -> Array:
    """The vectors (3, ...) turned by R (3, 3, ...)."""
    turned: Array = np.einsum("ij...,j...->i...", R, v)
    return turned


def rotate_back(R: Array, v: Array) -> Array:
    """The vectors (3, ...) turned by the transpose of R (3, 3, ...)."""
    turned: Array = np.einsum("ji...,j...->i...", R, v)
    return turned


def inverse(X: Pose) -> Pose:
    """X_BA from X_AB."""
    return Pose(np.swapaxes(X.R, 0, 1), -rotate_back(X.R, X.p))


def dot(a: Array, b: Array) -> Array:
    """Scalar products of vectors (n, ...)."""
    product: Array = np.einsum("i...,i...->...", a, b)
    return product


NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
"""The axes after each axis."""


def cross(a: Array, b: Array) -> Array:
    """Vector products of vectors (3, ...)."""
    product: Array = a.take(NEXT, 0) * b.take(LAST, 0) - a.take(LAST, 0) * b.take(NEXT, 0)
    return product


def multiply_per_link(M: Array, v: Array) -> Array:
    """The products of the links' constant matrices (i, j, 6) with v (..., j, 6, n), as (..., i, 6, n).

    The matrices are the same for the whole batch, so that this is a matrix product a link.
    """
    product = np.empty((*v.shape[:-3], M.shape[0], *v.shape[-2:]))
    by_link = np.ascontiguousarray(M.transpose(2, 0, 1))
    np.matmul(by_link, v.swapaxes(-3, -2), out=product.swapaxes(-3, -2))
    return product


def norm(v: Array) -> Array:
    """Lengths of vectors (n, ...)."""
    return np.sqrt(dot(v, v))


def gravity_direction(roll_rad: float, pitch_rad: float) -> Array:
    """Gravity's direction (3,) in RMECH of a rover rolled (right side down) after it is pitched (nose up)."""
    R_WR = rotation_y(np.array(pitch_rad)) @ rotation_x(np.array(roll_rad))
    down: Array = R_WR.T @ np.array([0.0, 0.0, 1.0])
    return down


def normalize(v: Array | tuple[float, float, float]) -> Array:
    """A vector (3,) of length one in the same direction."""
    along: Array = np.asarray(v) / np.linalg.norm(v)
    return along


def angle_between(a: Array, b: Array) -> float:
    """The angle between two vectors (3,), exact near 0 and pi too."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def rotation_x(angle_rad: Array) -> Array:
    """Rotations about x by angles (...), as (3, 3, ...)."""
    return _plane_rotation(angle_rad, 1, 2)


def rotation_y(angle_rad: Array) -> Array:
    """Rotations about y by angles (...), as (3, 3, ...)."""
    return _plane_rotation(angle_rad, 2, 0)


def rotation_z(angle_rad: Array) -> Array:
    """Rotations about z by angles (...), as (3, 3, ...)."""
    return _plane_rotation(angle_rad, 0, 1)


def _plane_rotation(angle_rad: Array, i: int, j: int) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    R = np.zeros((3, 3, *np.shape(c)))
    R[i, i] = R[j, j] = c
    R[j, i] = s
    R[i, j] = -s
    R[3 - i - j, 3 - i - j] = 1.0
    return R


def skew(v: Array) -> Array:
    """The matrices [v] with [v] w = v x w: (3, ...) to (3, 3, ...)."""
    K = np.zeros((3, *v.shape))
    K[0, 1], K[0, 2], K[1, 2] = -v[2], v[1], -v[0]
    K[1, 0], K[2, 0], K[2, 1] = v[2], -v[1], v[0]
    return K


def adjoint(X: Pose) -> Array:
    """The (6, 6, ...) that carries a screw from frame B to frame A: [[R, 0], [[p] R, R]].

    The paper's equation 3 prints [p] alone in the lower left; finite differences ask for [p] R.
    """
    J = np.zeros((6, 6, *X.R.shape[2:]))
    J[:3, :3] = J[3:, 3:] = X.R
    J[3:, :3] = compose(skew(X.p), X.R)
    return J


def screw_exp(screw: Array) -> Pose:
    """The pose reached by following a constant screw (6, ...) for one unit of time."""
    w = screw[:3]
    angle2 = dot(w, w)
    a, b, c = _exp_coefficients(angle2)
    W = skew(w)
    W2 = compose(W, W)
    eye = np.eye(3).reshape(3, 3, *(1,) * angle2.ndim)
    return Pose(eye + a * W + b * W2, rotate(eye + b * W + c * W2, screw[3:]))


def _exp_coefficients(angle2: Array) -> tuple[Array, Array, Array]:
    """sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3, by series where t is small."""
    small = angle2 < 1e-4
    t2 = np.where(small, 1.0, angle2)
    t = np.sqrt(t2)
    a = np.where(small, 1 - angle2 / 6 + angle2**2 / 120, np.sin(t) / t)
    b = np.where(small, 0.5 - angle2 / 24 + angle2**2 / 720, (1 - np.cos(t)) / t2)
    c = np.where(small, 1 / 6 - angle2 / 120 + angle2**2 / 5040, (t - np.sin(t)) / (t2 * t))
    return a, b, c


def wrap_angle(angle_rad: Array) -> Array:
    """The same angles in [-pi, pi)."""
    wrapped: Array = angle_rad - 2 * np.pi * np.floor(
        angle_rad / (2 * np.pi) + 0.5
    )  # % takes three times as long
    return wrapped
