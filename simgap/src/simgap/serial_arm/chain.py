"""Poses in batches, error screws, forward kinematics of a serial arm, and series of measured poses.

Components lead, the batch axis trails: a vector has shape (3, n), a rotation (3, 3, n), so that the inner
loops of numpy run over the batch. Parameters of links are (6,) or (joints, 6), in radians and metres; joint
angles are (n,) or (joints, n), vectors of any unit.
"""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.arrays import Array, Flags, Integers
from simgap.serial_arm.fit import Linearisation


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
    """Repeat a pose n times, as a batch (n,)."""
    return Pose(np.repeat(X.R[:, :, None], n, axis=2), np.repeat(X.p[:, None], n, axis=1))


def compose(R: Array, S: Array) -> Array:
    """Multiply rotations: R S, shape (3, 3, ...)."""
    return np.asarray(np.einsum("ik...,kj...->ij...", R, S))


def rotate(R: Array, v: Array) -> Array:
    """Rotate vectors: R v, shape (3, ...), unit of v."""
    return np.asarray(np.einsum("ij...,j...->i...", R, v))


def rotate_back(R: Array, v: Array) -> Array:
    """Rotate vectors by the transposes of rotations: R^T v, shape (3, ...), unit of v."""
    return np.asarray(np.einsum("ji...,j...->i...", R, v))


def norm(v: Array) -> Array:
    """Compute the Euclidean norm of vectors, shape (n,), unit of v."""
    return np.asarray(np.sqrt(np.einsum("in,in->n", v, v)))


def skew(v: Array) -> Array:
    """Build the matrices [v], shape (3, 3, n), of the vector product: [v] w = v x w."""
    K = np.zeros((3, *v.shape))
    K[0, 1], K[0, 2], K[1, 2] = -v[2], v[1], -v[0]
    K[1, 0], K[2, 0], K[2, 1] = v[2], -v[1], v[0]
    return K


def screw_log(X: AnyPose) -> Array:
    """Compute the logarithm of poses below half a turn: rotation [rad] above translation [m], (6, n)."""
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
    """Compute error screws, (6, n), the log of D_error (paper equation 14), in axes of the modelled poses."""
    X_MR = Pose(np.swapaxes(X_RM.R, 0, 1), -rotate_back(X_RM.R, X_RM.p))
    return screw_log(X_MR @ Pose(X_RT.R, X_RT.p))


def linearise(X_RM: AnyPose, jacobian: Array, X_RT: AnyPose, whitener: Array) -> Linearisation:
    """Compute whitened error screws of modelled poses with their derivatives.

    Args:
        jacobian: Screws of the modelled poses in their own axes, per unit of each parameter, shape (6, n, p).
        whitener: Matrices that make the errors whitened, shape (n, 6, 6); rows may be 0.
    """
    T = error_screw(X_RM, X_RT)
    derivatives = -np.einsum("ijn,jnp->nip", _inverse_left_jacobian(T), jacobian)
    return Linearisation(np.einsum("nij,jn->ni", whitener, T), whitener @ derivatives)


def _inverse_left_jacobian(T: Array) -> Array:
    """Compute the inverse left Jacobian J, (6, 6, n), of the exponential: log(exp(d) exp(T)) = T + J d.

    The series ends after the fourth power of T. For screws of 0.01, its relative error is 1e-11.
    """
    ad = np.zeros((6, *T.shape))
    ad[:3, :3] = ad[3:, 3:] = skew(T[:3])
    ad[3:, :3] = skew(T[3:])
    ad2 = np.einsum("ikn,kjn->ijn", ad, ad)
    second_order = np.eye(6)[:, :, None] - ad / 2 + ad2 / 12
    return np.asarray(second_order - np.einsum("ikn,kjn->ijn", ad2, ad2) / 720)


LinkGeometry = Array
"""Parameters theta, d, beta, b, alpha, a of one link, shape (6,)."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkAxes:
    """Axes of a link transform and points on them, in the frame of the chain; batch shape (3, n)."""

    z: Array
    p_z_m: Array
    """theta rotates about z through this point, d translates along it."""
    y: Array
    p_y_m: Array
    """beta rotates about y through this point, b translates along it."""
    x: Array
    p_x_m: Array
    """alpha rotates about x through this point, a translates along it."""

    def screws(self, X_M: Pose) -> Array:
        """Compute a later frame's derivatives by the six parameters: screws in its own axes, (6, n, 6)."""
        columns = []
        for axis, point in ((self.z, self.p_z_m), (self.y, self.p_y_m), (self.x, self.p_x_m)):
            v = rotate_back(X_M.R, axis)
            moment = rotate_back(X_M.R, np.cross(axis, X_M.p - point, axis=0))
            columns += [np.concatenate([v, moment]), np.concatenate([np.zeros_like(v), v])]
        return np.stack(columns, axis=-1)


def link_transform(X: Pose, turn_rad: Array, geometry: LinkGeometry) -> tuple[Pose, LinkAxes]:
    """Compute the frame at the end of a link (paper equation 1), and the axes of its parameters."""
    theta, d, beta, b, alpha, a = geometry
    x, y, z = X.R[:, 0], X.R[:, 1], X.R[:, 2]
    x_theta, y_theta = _turn(x, y, turn_rad + theta)
    p_y = X.p + d * z
    z_beta, x_beta = _turn(z, x_theta, beta)
    p_x = p_y + b * y_theta
    y_alpha, z_alpha = _turn(y_theta, z_beta, alpha)
    X_E = Pose(np.stack([x_beta, y_alpha, z_alpha], axis=1), p_x + a * x_beta)
    return X_E, LinkAxes(z, X.p, y_theta, p_y, x_beta, p_x)


def _turn(u: Array, v: Array, angle_rad: Array) -> tuple[Array, Array]:
    """Rotate two perpendicular axes in their plane, from the first towards the second."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return c * u + s * v, c * v - s * u


def forward_kinematics(X: Pose, link_geometry: Array, turn_rad: Array) -> tuple[list[Pose], list[LinkAxes]]:
    """Compute the frames at the ends of all links, the last one the flange, and the axes of each link."""
    ends, axes = [], []
    for geometry, turn in zip(link_geometry, turn_rad, strict=True):
        X, link_axes = link_transform(X, turn, geometry)
        ends.append(X)
        axes.append(link_axes)
    return ends, axes


def load_torque_Nm(
    ends: list[Pose], axes: list[LinkAxes], masses_kg: Array, p_EoCo_E_m: Array, gravity_m_s2: Array
) -> Array:
    """Compute the gravity torque on each joint, positive in its direction, (joints, n) [N m].

    Args:
        masses_kg: Masses of the links, shape (joints,).
        p_EoCo_E_m: Centres of mass in the frames at the ends, shape (joints, 3).
        gravity_m_s2: Gravity in the frame of the chain, shape (3,).
    """
    weight = masses_kg[:, None] * gravity_m_s2
    mass_centres = [X.p + rotate(X.R, p[:, None]) for X, p in zip(ends, p_EoCo_E_m, strict=True)]
    torques = []
    for j, about in enumerate(axes):
        outer = ((mass_centres[k] - about.p_z_m, weight[k][:, None]) for k in range(j, len(ends)))
        moment = sum(np.cross(lever, force, axis=0) for lever, force in outer)
        torques.append(np.sum(about.z * moment, axis=0))
    return np.array(torques)


STILL_RAD: Final = 1e-3
"""Largest motion of a joint since the last pose after which its direction counts as unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseSeries:
    """Joint angles that the arm read, with the target that the tracker measured."""

    name: str
    joint_rad: Array
    """Joint angles, shape (joints, n)."""
    direction: Array
    """Direction of each joint's last move: +1, -1 or 0, shape (joints, n)."""
    X_TM: Pose
    """Target M in the tracker's frame T, batch (n,)."""
    air_C: Array | None
    """Air temperature, shape (n,); None if unknown."""
    row: Integers
    """Row number of each pose in its table; the first row below the header is 1."""

    @property
    def count(self) -> int:
        """Return the number of poses."""
        return self.row.size

    def at(self, poses: Flags | Integers) -> "PoseSeries":
        """Select some of the poses; directions of moves stay those of the whole series."""
        air = None if self.air_C is None else self.air_C[poses]
        return PoseSeries(
            self.name,
            self.joint_rad[:, poses],
            self.direction[:, poses],
            self.X_TM[poses],
            air,
            self.row[poses],
        )


def move_directions(joint_rad: Array) -> Array:
    """Compute the direction of each joint's last move in order of time: +1, -1 or 0, shape (joints, n)."""
    motion = np.diff(joint_rad, axis=1, prepend=joint_rad[:, :1])
    return np.where(np.abs(motion) > STILL_RAD, np.sign(motion), 0.0)
