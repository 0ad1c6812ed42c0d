"""The error of a modelled pose as a screw, and the noise of a measured one: paper equations 14 to 17."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.kinematics.transforms import Array, Pose, compose, dot, inverse, rotate, skew
from ground.calibration.fit import Linearisation


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoses:
    """Poses as they were measured, and how well."""

    X_RT: Pose
    """Batch (n,)."""
    covariance: Array
    """Of the screw from the true to the measured pose, in its axes, rotation first, (n, 6, 6)."""

    @property
    def whitener(self) -> Array:
        """What makes such a screw one of independent components of variance 1, (n, 6, 6)."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))


def screw_log(X: Pose) -> Array:
    """The screw (6, n) that leads to a pose in one unit of time; the turn is less than half a one."""
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
    """The screw (6, n) from modelled poses to measured ones, in axes of the modelled: log of D_error."""
    return screw_log(inverse(X_RM) @ measured.X_RT)


def linearise(
    X_RM: Pose, moved: Array, measured: MeasuredPoses, whitener: Array | None = None
) -> Linearisation:
    """Whitened error screws of modelled poses, and their derivatives.

    `moved` (6, n, p): the screw by which a modelled pose moves, in its own axes, per unit of each parameter.
    The whitener (n, 6, 6) is that of the measurement unless another is given; rows of it may be 0.
    """
    T = error_screw(X_RM, measured)
    W = measured.whitener if whitener is None else whitener
    turned = -np.einsum("ijn,jnp->nip", _inverse_left_jacobian(T), moved)
    return Linearisation(np.einsum("nij,jn->ni", W, T), W @ turned)


def _inverse_left_jacobian(T: Array) -> Array:
    """Of the exponential, (6, 6, n): log(exp(d) exp(T)) = T + this d, to the fourth power of T.

    Of screws of a hundredth, what is left out is a share of 1e-11.
    """
    ad = np.zeros((6, *T.shape))
    ad[:3, :3] = ad[3:, 3:] = skew(T[:3])
    ad[3:, :3] = skew(T[3:])
    ad2 = np.einsum("ikn,kjn->ijn", ad, ad)
    near = np.eye(6)[:, :, None] - ad / 2 + ad2 / 12
    result: Array = near - np.einsum("ikn,kjn->ijn", ad2, ad2) / 720
    return result
