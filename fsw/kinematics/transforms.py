"""Rotations, poses and screws, single or in batches: components lead, batch axes trail.

A vector has shape (3, ...), a rotation (3, 3, ...), a screw (6, ...) with the rotation first. With the
components leading, the inner loops of numpy run over the batch. The functions take all of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]


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

    def __getitem__(self, index: object) -> "Pose":
        """Return the poses at an index of the batch axes."""
        indices = index if isinstance(index, tuple) else (index,)
        return Pose(self.R[(slice(None), slice(None), *indices)], self.p[(slice(None), *indices)])


def stack_poses(poses: Sequence[Pose]) -> Pose:
    """Stack poses of one batch shape along a new last axis."""
    return Pose(np.stack([X.R for X in poses], -1), np.stack([X.p for X in poses], -1))


IDENTITY = Pose(np.eye(3), np.zeros(3))


def compose(R: Array, S: Array) -> Array:
    """Multiply rotations: R S."""
    product: Array = np.einsum("ik...,kj...->ij...", R, S)
    return product


def rotate(R: Array, v: Array) -> Array:
    """Rotate vectors: R v, in the unit of v."""
    turned: Array = np.einsum("ij...,j...->i...", R, v)
    return turned


def rotate_back(R: Array, v: Array) -> Array:
    """Rotate vectors by the transposes of rotations: R^T v, in the unit of v."""
    turned: Array = np.einsum("ji...,j...->i...", R, v)
    return turned


def inverse(X: Pose) -> Pose:
    """Invert poses: X_AB to X_BA."""
    return Pose(np.swapaxes(X.R, 0, 1), -rotate_back(X.R, X.p))


def dot(a: Array, b: Array) -> Array:
    """Compute scalar products of vectors, (n, ...)."""
    product: Array = np.einsum("i...,i...->...", a, b)
    return product


NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
"""The next axis and the one after it, for each axis."""


def cross(a: Array, b: Array) -> Array:
    """Compute vector products."""
    product: Array = a.take(NEXT, 0) * b.take(LAST, 0) - a.take(LAST, 0) * b.take(NEXT, 0)
    return product


def multiply_per_link(M: Array, v: Array) -> Array:
    """Multiply a constant matrix of each link, (i, j, 6), with values of that link, (..., j, 6, n).

    The matrices are the same for the whole batch, so one matrix product per link suffices.
    """
    product = np.empty((*v.shape[:-3], M.shape[0], *v.shape[-2:]))
    by_link = np.ascontiguousarray(M.transpose(2, 0, 1))
    np.matmul(by_link, v.swapaxes(-3, -2), out=product.swapaxes(-3, -2))
    return product


def norm(v: Array) -> Array:
    """Compute the Euclidean norm of vectors, (n, ...), in their unit."""
    return np.sqrt(dot(v, v))


def gravity_direction(roll_rad: float, pitch_rad: float) -> Array:
    """Compute the direction of gravity in RMECH, a unit vector, for a rover that is pitched and then rolled.

    Roll is positive with the right side down, pitch with the nose up.
    """
    R_WR = rotation_y(np.array(pitch_rad)) @ rotation_x(np.array(roll_rad))
    down: Array = R_WR.T @ np.array([0.0, 0.0, 1.0])
    return down


def normalize(v: Array | tuple[float, float, float]) -> Array:
    """Scale a vector, (3,), to unit length."""
    along: Array = np.asarray(v) / np.linalg.norm(v)
    return along


def angle_between(a: Array, b: Array) -> float:
    """Compute the angle between two vectors, without loss of digits near 0 and pi."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _plane_rotation(i: int, j: int, angle_rad: Array) -> Array:
    """Build rotations that turn axis i towards axis j."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    R = np.zeros((3, 3, *np.shape(c)))
    R[i, i] = R[j, j] = c
    R[j, i] = s
    R[i, j] = -s
    R[3 - i - j, 3 - i - j] = 1.0
    return R


rotation_x, rotation_y, rotation_z = (partial(_plane_rotation, *axes) for axes in ((1, 2), (2, 0), (0, 1)))
"""Build rotations, (3, 3, ...), about an axis by angles in rad, (...)."""


def skew(v: Array) -> Array:
    """Build the matrices [v] of the vector product: [v] w = v x w."""
    K = np.zeros((3, *v.shape))
    K[0, 1], K[0, 2], K[1, 2] = -v[2], v[1], -v[0]
    K[1, 0], K[2, 0], K[2, 1] = v[2], -v[1], v[0]
    return K


def adjoint(X: Pose) -> Array:
    """Build the matrices [[R, 0], [[p] R, R]] of poses X_AB, which transform a screw from frame B to frame A.

    Equation 3 of the paper prints [p] alone in the lower left. Finite differences confirm [p] R.
    """
    J = np.zeros((6, 6, *X.R.shape[2:]))
    J[:3, :3] = J[3:, 3:] = X.R
    J[3:, :3] = compose(skew(X.p), X.R)
    return J


def screw_exp(screw: Array) -> Pose:
    """Compute poses that constant screws, (6, ...) [rad, m], reach in one unit of time: exp of SE(3)."""
    w = screw[:3]
    angle2 = dot(w, w)
    a, b, c = _exp_coefficients(angle2)
    W = skew(w)
    W2 = compose(W, W)
    eye = np.eye(3).reshape(3, 3, *(1,) * angle2.ndim)
    return Pose(eye + a * W + b * W2, rotate(eye + b * W + c * W2, screw[3:]))


def _exp_coefficients(angle2: Array) -> tuple[Array, Array, Array]:
    """Compute sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3, by series where t is small."""
    small = angle2 < 1e-4
    t2 = np.where(small, 1.0, angle2)
    t = np.sqrt(t2)
    a = np.where(small, 1 - angle2 / 6 + angle2**2 / 120, np.sin(t) / t)
    b = np.where(small, 0.5 - angle2 / 24 + angle2**2 / 720, (1 - np.cos(t)) / t2)
    c = np.where(small, 1 / 6 - angle2 / 120 + angle2**2 / 5040, (t - np.sin(t)) / (t2 * t))
    return a, b, c


def wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles into [-pi, pi)."""
    # the operator % takes three times as long
    wrapped: Array = angle_rad - 2 * np.pi * np.floor(angle_rad / (2 * np.pi) + 0.5)
    return wrapped


Record = TypeVar("Record")


def record_arrays(record: Any) -> tuple[NDArray[Any], ...]:
    """Return the arrays of a data class, in the order of the fields."""
    return tuple(getattr(record, field.name) for field in fields(record))


def select_targets(record: Record, where: Any) -> Record:
    """Select targets of a data class of arrays, (..., n), by an index of the last axis."""
    # an index alone leaves the values of a target next to each other, and all that follows is slower
    return type(record)(*(np.ascontiguousarray(values[..., where]) for values in record_arrays(record)))


def concatenate_records(parts: Sequence[Record]) -> Record:
    """Concatenate one or more data classes of arrays, (..., n), along the last axis."""
    if len(parts) == 1:
        return parts[0]
    columns = zip(*(record_arrays(part) for part in parts), strict=True)
    return type(parts[0])(*(np.concatenate(column, axis=-1) for column in columns))
