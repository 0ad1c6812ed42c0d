"""Error screws of modelled poses and the noise of measured poses: paper equations 14 to 17."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.kinematics.transforms import Array, Pose, compose, dot, inverse, rotate, skew
from ground.calibration.fit import Linearisation


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoses:
    """Measured poses with their covariances."""

    X_RT: Pose
    """Turret frame in the rover frame, batch (n,)."""
    covariance: Array
    """Covariance of the screw from true to measured pose, in its axes, rotation first, shape (n, 6, 6)."""

    @property
    def whitener(self) -> Array:
        """Compute the matrices that make this screw independent with unit variance, shape (n, 6, 6)."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))


def screw_log(X: Pose) -> Array:
    """Compute the logarithm of poses, for rotations below half a turn.

    Args:
        X: Poses, batch (n,).

    Returns:
        Screws, rotation [rad] above translation [m], shape (6, n).
    """
    w = Rotation.from_matrix(np.moveaxis(X.R, -1, 0)).as_rotvec().T
    angle2 = dot(w, w)
    small = angle2 < 1e-4
    t2 = np.where(small, 1.0, angle2)
    t = np.sqrt(t2)
    half = np.where(small, 1 / 12 + angle2 / 720, (1 - t * np.sin(t) / (2 * (1 - np.cos(t)))) / t2)
    W = skew(w)
    inverse_V = np.eye(3)[:, :, None] - 0.5 * W + half * compose(W, W)
    return np.concatenate([w, rotate(inverse_V, X.p)])


def error_screw(X_RM: Pose, measured: MeasuredPoses) -> Array:
    """Compute the error screws, the logarithm of D_error (paper equation 14).

    Args:
        X_RM: Modelled poses, batch (n,).
        measured: Measured poses.

    Returns:
        Screws from modelled to measured poses in axes of the modelled ones, rotation [rad] above
        translation [m], shape (6, n).
    """
    return screw_log(inverse(X_RM) @ measured.X_RT)


def linearise(
    X_RM: Pose, jacobian: Array, measured: MeasuredPoses, whitener: Array | None = None
) -> Linearisation:
    """Compute whitened error screws of modelled poses with their derivatives.

    Args:
        X_RM: Modelled poses, batch (n,).
        jacobian: Screws of the modelled poses in their own axes, per unit of each parameter, shape (6, n, p).
        measured: Measured poses.
        whitener: Matrices that make the errors whitened, shape (n, 6, 6); rows may be 0. By default those
            of the measurement.

    Returns:
        The linearisation of the residuals.
    """
    T = error_screw(X_RM, measured)
    W = measured.whitener if whitener is None else whitener
    derivatives = -np.einsum("ijn,jnp->nip", _inverse_left_jacobian(T), jacobian)
    return Linearisation(np.einsum("nij,jn->ni", W, T), W @ derivatives)


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
