"""Forward kinematics of a serial arm, with the axes of its parameters and gravity torques."""

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Array
from simgap.serial_arm.poses import Pose, rotate, rotate_back

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
        """Compute the derivatives of a later frame by the six parameters of the link.

        Args:
            X_M: Frame M in the frame of the chain, batch (n,).

        Returns:
            Screws of M in its own axes per unit of each parameter, shape (6, n, 6).
        """
        columns = []
        for axis, point in ((self.z, self.p_z_m), (self.y, self.p_y_m), (self.x, self.p_x_m)):
            v = rotate_back(X_M.R, axis)
            moment = rotate_back(X_M.R, np.cross(axis, X_M.p - point, axis=0))
            columns += [np.concatenate([v, moment]), np.concatenate([np.zeros_like(v), v])]
        return np.stack(columns, axis=-1)


def link_transform(X: Pose, turn_rad: Array, geometry: LinkGeometry) -> tuple[Pose, LinkAxes]:
    """Compute the frame at the end of a link (paper equation 1).

    Args:
        X: Frame at the beginning of the link, batch (n,).
        turn_rad: Joint angles, shape (n,).
        geometry: Parameters of the link, angles in radians, lengths in metres, shape (6,).

    Returns:
        The frame at the end, batch (n,), and the axes of the parameters.
    """
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
    """Compute the frames at the ends of all links; the last one is the flange.

    Args:
        X: Frame at the beginning of the first link, batch (n,).
        link_geometry: Parameters of the links, angles in radians, lengths in metres, shape (joints, 6).
        turn_rad: Joint angles, shape (joints, n).

    Returns:
        The frames, batch (n,) each, and the axes of each link.
    """
    ends, axes = [], []
    for geometry, turn in zip(link_geometry, turn_rad, strict=True):
        X, link_axes = link_transform(X, turn, geometry)
        ends.append(X)
        axes.append(link_axes)
    return ends, axes


def load_torque_Nm(
    ends: list[Pose], axes: list[LinkAxes], masses_kg: Array, p_EoCo_E_m: Array, gravity_m_s2: Array
) -> Array:
    """Compute the gravity torque on each joint.

    Args:
        ends: Frames at the ends of the links, batch (n,) each.
        axes: Axes of each link.
        masses_kg: Masses of the links, shape (joints,).
        p_EoCo_E_m: Centres of mass in the frames at the ends, shape (joints, 3).
        gravity_m_s2: Gravity in the frame of the chain, shape (3,).

    Returns:
        Torques [N m], positive in the direction of the joint, shape (joints, n).
    """
    weight = masses_kg[:, None] * gravity_m_s2
    mass_centres = [X.p + rotate(X.R, p[:, None]) for X, p in zip(ends, p_EoCo_E_m, strict=True)]
    torques = []
    for j, about in enumerate(axes):
        outer = ((mass_centres[k] - about.p_z_m, weight[k][:, None]) for k in range(j, len(ends)))
        moment = sum(np.cross(lever, force, axis=0) for lever, force in outer)
        torques.append(np.sum(about.z * moment, axis=0))
    return np.array(torques)
