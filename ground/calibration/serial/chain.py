"""Forward kinematics of a serial arm, and the axes about and along which its numbers move what follows."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array, Pose, compose, cross, rotate, rotate_back, rotation_x, rotation_y

LinkGeometry = Array
"""theta, d, beta, b, alpha, a of one link, (6,)."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkAxes:
    """The three axes of a link transform and where they are; batch (n,) each, in the frame of the chain."""

    z: Array
    p_z_m: Array
    """theta turns about z through this point, d shifts along it."""
    y: Array
    p_y_m: Array
    """beta turns about y through this point, b shifts along it."""
    x: Array
    p_x_m: Array
    """alpha turns about x through this point, a shifts along it."""

    def screws(self, X_M: Pose) -> Array:
        """The screw of a frame M that follows, in its own axes, per unit of the six numbers, (6, n, 6)."""
        columns = []
        for axis, point in ((self.z, self.p_z_m), (self.y, self.p_y_m), (self.x, self.p_x_m)):
            v = rotate_back(X_M.R, axis)
            turned = rotate_back(X_M.R, cross(axis, X_M.p - point))
            columns += [np.concatenate([v, turned]), np.concatenate([np.zeros_like(v), v])]
        return np.stack(columns, axis=-1)


def link_transform(X: Pose, turn_rad: Array, six: LinkGeometry) -> tuple[Pose, LinkAxes]:
    """The end of a link that begins at frames X, batch (n,), its joint turned by (n,); and its axes."""
    theta, d, beta, b, alpha, a = six
    c, s = np.cos(turn_rad + theta), np.sin(turn_rad + theta)
    x, y, z = X.R[:, 0], X.R[:, 1], X.R[:, 2]
    R = np.stack([c * x + s * y, c * y - s * x, z], axis=1)
    p_y = X.p + d * z
    bent = compose(R, rotation_y(np.array(beta))[..., None])
    p_x = p_y + b * R[:, 1]
    X_E = Pose(compose(bent, rotation_x(np.array(alpha))[..., None]), p_x + a * bent[:, 0])
    return X_E, LinkAxes(z, X.p, R[:, 1], p_y, bent[:, 0], p_x)


def forward_kinematics(X: Pose, sixes: Array, turn_rad: Array) -> tuple[list[Pose], list[LinkAxes]]:
    """The ends of all links, the last of which is the flange, and their axes.

    Links (L, 6) that begin at frames X, batch (n,), their joints turned by angles (L, n).
    """
    ends, axes = [], []
    for six, turn in zip(sixes, turn_rad, strict=True):
        X, moved_by = link_transform(X, turn, six)
        ends.append(X)
        axes.append(moved_by)
    return ends, axes


def repeat_pose(X: Pose, n: int) -> Pose:
    """One pose n times, batch (n,)."""
    return Pose(np.repeat(X.R[:, :, None], n, axis=2), np.repeat(X.p[:, None], n, axis=1))


def load_torque_Nm(
    ends: list[Pose], axes: list[LinkAxes], masses_kg: Array, p_EoCo_E_m: Array, gravity: Array
) -> Array:
    """What gravity turns each joint with, positive as the joint is, (L, n).

    Links' masses (L,) at points (L, 3) of the frames at their ends; gravity (3,) in the frame of the chain.
    """
    weight = masses_kg[:, None] * gravity
    heavy = [X.p + rotate(X.R, p[:, None]) for X, p in zip(ends, p_EoCo_E_m, strict=True)]
    torques = []
    for j, about in enumerate(axes):
        moment = sum(cross(heavy[k] - about.p_z_m, weight[k][:, None]) for k in range(j, len(ends)))
        torques.append(np.sum(about.z * moment, axis=0))
    return np.array(torques)
