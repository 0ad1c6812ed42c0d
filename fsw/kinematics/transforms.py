"""Rotations, homogeneous transforms and screws, for one or for many: every leading axis is a batch axis.

A transform X_AB is 4x4 and gives frame B in frame A; a screw is (rotation, translation), rotation first.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_x(angle_rad: Array) -> Array:
    """Rotation about x; angles of shape (...), result (..., 3, 3)."""
    return _plane_rotation(np.asarray(angle_rad, float), 1, 2)


def rotation_y(angle_rad: Array) -> Array:
    """Rotation about y; angles of shape (...), result (..., 3, 3)."""
    return _plane_rotation(np.asarray(angle_rad, float), 2, 0)


def rotation_z(angle_rad: Array) -> Array:
    """Rotation about z; angles of shape (...), result (..., 3, 3)."""
    return _plane_rotation(np.asarray(angle_rad, float), 0, 1)


def _plane_rotation(angle_rad: Array, i: int, j: int) -> Array:
    R = np.zeros((*angle_rad.shape, 3, 3))
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    R[..., i, i] = c
    R[..., j, j] = c
    R[..., j, i] = s
    R[..., i, j] = -s
    R[..., 3 - i - j, 3 - i - j] = 1.0
    return R


def rigid(R: Array, p_m: Array) -> Array:
    """The transform with rotation R (..., 3, 3) and translation p (..., 3)."""
    p_m = np.asarray(p_m, float)
    X = np.zeros((*np.broadcast_shapes(R.shape[:-2], p_m.shape[:-1]), 4, 4))
    X[..., :3, :3] = R
    X[..., :3, 3] = p_m
    X[..., 3, 3] = 1.0
    return X


def translation(p_m: Array) -> Array:
    """The transform that only translates, by p of shape (..., 3)."""
    return rigid(np.eye(3), p_m)


def inverse(X: Array) -> Array:
    """X_BA from X_AB."""
    R_T = np.swapaxes(X[..., :3, :3], -1, -2)
    return rigid(R_T, -(R_T @ X[..., :3, 3:])[..., 0])


def skew(p: Array) -> Array:
    """The matrix [p] with [p] v = p x v; shape (..., 3) to (..., 3, 3)."""
    K = np.zeros((*p.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -p[..., 2], p[..., 1], -p[..., 0]
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = p[..., 2], -p[..., 1], p[..., 0]
    return K


def adjoint(X: Array) -> Array:
    """The 6x6 that carries a screw from frame B to frame A: [[R, 0], [[p] R, R]], rotation first.

    The paper's equation 3 prints [p] alone in the lower left; finite differences ask for [p] R.
    """
    R = X[..., :3, :3]
    J = np.zeros((*X.shape[:-2], 6, 6))
    J[..., :3, :3] = R
    J[..., 3:, 3:] = R
    J[..., 3:, :3] = skew(X[..., :3, 3]) @ R
    return J


def screw_exp(screw: Array) -> Array:
    """The transform reached by following a constant screw (..., 6) for one unit of time."""
    w, v = screw[..., :3], screw[..., 3:]
    angle2 = np.sum(w * w, axis=-1)[..., None, None]
    a, b, c = _exp_coefficients(angle2)
    W = skew(w)
    W2 = W @ W
    R = np.eye(3) + a * W + b * W2
    V = np.eye(3) + b * W + c * W2
    return rigid(R, (V @ v[..., None])[..., 0])


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
    """The same angle in [-pi, pi)."""
    wrapped: Array = (angle_rad + np.pi) % (2 * np.pi) - np.pi
    return wrapped
