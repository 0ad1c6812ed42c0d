"""Error screws of modelled poses, whitened, with their derivatives: paper equation 14."""

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.arrays import Array
from simgap.serial_arm.fit import Linearisation
from simgap.serial_arm.poses import AnyPose, compose, relative_pose, rotate, skew


def screw_log(X: AnyPose) -> Array:
    """Compute the logarithm of poses, for rotations below half a turn.

    Args:
        X: Poses, batch (n,).

    Returns:
        Screws, rotation [rad] above translation [m], shape (6, n).
    """
    w = Rotation.from_matrix(np.moveaxis(X.R, -1, 0)).as_rotvec().T
    angle2 = np.einsum("in,in->n", w, w)
    small = angle2 < 1e-4
    t2 = np.where(small, 1.0, angle2)
    t = np.sqrt(t2)
    half = np.where(small, 1 / 12 + angle2 / 720, (1 - t * np.sin(t) / (2 * (1 - np.cos(t)))) / t2)
    W = skew(w)
    inverse_V = np.eye(3)[:, :, None] - 0.5 * W + half * compose(W, W)
    return np.concatenate([w, rotate(inverse_V, X.p)])


def error_screw(X_RM: AnyPose, X_RT: AnyPose) -> Array:
    """Compute the error screws, the logarithm of D_error (paper equation 14).

    Args:
        X_RM: Modelled poses, batch (n,).
        X_RT: Measured poses, batch (n,).

    Returns:
        Screws from modelled to measured poses in axes of the modelled ones, rotation [rad] above
        translation [m], shape (6, n).
    """
    return screw_log(relative_pose(X_RM, X_RT))


def linearise(X_RM: AnyPose, jacobian: Array, X_RT: AnyPose, whitener: Array) -> Linearisation:
    """Compute whitened error screws of modelled poses with their derivatives.

    Args:
        X_RM: Modelled poses, batch (n,).
        jacobian: Screws of the modelled poses in their own axes, per unit of each parameter, shape (6, n, p).
        X_RT: Measured poses, batch (n,).
        whitener: Matrices that make the errors whitened, shape (n, 6, 6); rows may be 0.

    Returns:
        The linearisation of the residuals.
    """
    T = error_screw(X_RM, X_RT)
    derivatives = -np.einsum("ijn,jnp->nip", _inverse_left_jacobian(T), jacobian)
    return Linearisation(np.einsum("nij,jn->ni", whitener, T), whitener @ derivatives)


def _inverse_left_jacobian(T: Array) -> Array:
    """Compute the inverse left Jacobian J of the exponential: log(exp(d) exp(T)) = T + J d.

    The series ends after the fourth power of T. For screws of 0.01, its relative error is 1e-11.

    Returns:
        Matrices, shape (6, 6, n).
    """
    ad = np.zeros((6, *T.shape))
    ad[:3, :3] = ad[3:, 3:] = skew(T[:3])
    ad[3:, :3] = skew(T[3:])
    ad2 = np.einsum("ikn,kjn->ijn", ad, ad)
    second_order = np.eye(6)[:, :, None] - ad / 2 + ad2 / 12
    result: Array = second_order - np.einsum("ikn,kjn->ijn", ad2, ad2) / 720
    return result
