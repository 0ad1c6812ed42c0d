"""Forward kinematics of the deflected chain, and its Jacobians by joint and by frame.

For a single pose, chain and load are computed in plain numbers: for six links, arrays take several times as
long. The formulas of a spring are shared: they hold for numbers and for arrays. A test compares the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import Final, TypeVar

import numpy as np

from fsw.kinematics.arm import Arm, Link, Rotation, Row, Vector
from fsw.kinematics.transforms import IDENTITY, Array, Pose, adjoint, cross, multiply_per_link, rotate

Number = TypeVar("Number", float, Array)
LinkPose = tuple[Rotation, Vector, Rotation, Vector, Rotation, Vector]
"""Poses X_RL, X_LD and X_RF of a link, as in `chain.Frames`."""
NO_STRAIN: Final = (0.0,) * 36


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Poses along the arm, batch (6, ...) each, links from the rover outward.

    The joint that moves link i turns about the z axis of X_RL[i], through its origin.
    """

    X_RL: Pose
    """Link frames after the turn of their joints, in the rover frame RMECH."""
    X_LD: Pose
    """Far side of each spring in the link frame."""
    X_RF: Pose
    """Frames at the ends of the links, Arm1 to Arm6, in the rover frame."""


def forward(arm: Arm, output_rad: Array, strain: Array | None = None) -> Frames:
    """Compute all frames of the arm: equation 2 of the paper, with a transform for each link's spring."""
    if output_rad.ndim == 1:
        return collect_frames(place_pose(arm, output_rad, strain))
    batch = output_rad.shape[1:]
    ones = (1,) * len(batch)
    angle = np.zeros((6, *batch))
    angle[1:] = output_rad
    angle += arm.theta_rad.reshape(6, *ones)
    cosine, sine = np.cos(angle), np.sin(angle)
    # poses are (3, 4, ...), so that one product rotates both rotation and translation
    if strain is None:
        p_LD = arm.p_LC_m.reshape(3, 6, *ones)
        X_LD = Pose(np.broadcast_to(IDENTITY.R.reshape(3, 3, 1, *ones), (3, 3, 6, *ones)), p_LD)
        X_LF = arm.RP_CF.reshape(3, 4, 6, *ones).copy()
    else:
        X_LD = spring_pose(arm, strain)
        R_LD = X_LD.R.reshape(3, 3, 6, -1)
        X_LF = multiply_per_link(arm.RP_CF.swapaxes(0, 1), R_LD).reshape(3, 4, *X_LD.R.shape[2:])
    X_LF[:, 3] += X_LD.p
    X_SF = np.empty((3, 4, 6, *batch))  # in the start frame of the link, before its joint turns
    np.multiply(cosine, X_LF[0], out=X_SF[0])
    X_SF[0] -= sine * X_LF[1]
    np.multiply(sine, X_LF[0], out=X_SF[1])
    X_SF[1] += cosine * X_LF[1]
    X_SF[2] = X_LF[2]
    R_RS = np.empty((3, 3, 7, *batch))
    R_RS[:, :, 0] = IDENTITY.R.reshape(3, 3, *ones)
    R_RS[:, :, 1] = X_SF[:, :3, 0]
    for i in range(1, 6):
        np.einsum("ik...,kj...->ij...", R_RS[:, :, i], X_SF[:, :3, i], out=R_RS[:, :, i + 1])
    p_RS = np.zeros((3, 7, *batch))
    np.add.accumulate(rotate(R_RS[:, :, :6], X_SF[:, 3]), axis=1, out=p_RS[:, 1:])
    R_RL = np.empty((3, 3, 6, *batch))
    x, y = R_RS[:, 0, :6], R_RS[:, 1, :6]
    np.multiply(x, cosine, out=R_RL[:, 0])
    R_RL[:, 0] += y * sine
    np.multiply(y, cosine, out=R_RL[:, 1])
    R_RL[:, 1] -= x * sine
    R_RL[:, 2] = R_RS[:, 2, :6]
    return Frames(Pose(R_RL, p_RS[:, :6]), X_LD, Pose(R_RS[:, :, 1:], p_RS[:, 1:]))


def place_pose(arm: Arm, output_rad: Array, strain: Array | None) -> list[LinkPose]:
    """Place the links of a single pose."""
    return place_links(
        arm.links, output_rad.tolist(), NO_STRAIN if strain is None else strain.ravel().tolist()
    )


def collect_frames(placed: list[LinkPose]) -> Frames:
    """Collect the frames of a single pose."""
    numbers = np.array([number for link in placed for part in link for number in part]).reshape(6, 36).T
    rotations = [numbers[k : k + 9].reshape(3, 3, 6) for k in (0, 12, 24)]
    X_RL, X_LD, X_RF = (Pose(R, numbers[k : k + 3]) for R, k in zip(rotations, (9, 21, 33), strict=True))
    return Frames(X_RL, X_LD, X_RF)


def spring_pose(arm: Arm, strain: Array) -> Pose:
    """Compute the far side of each spring in the frame of its link.

    A spring translates, then turns about x, y and z in this order; each turn carries the later axes. The
    spring of the plant does the same. At 45 mrad the order matters by a tenth of a millimetre.

    Returns:
        The poses, batch (6, ...).
    """
    cosine, sine = small_cos_sin(strain[:3])
    R = np.concatenate(spring_turn(*cosine, *sine)).reshape(3, 3, *strain.shape[1:])
    return Pose(R, strain[3:] + arm.p_LC_m.reshape(3, 6, *(1,) * (strain.ndim - 2)))


def tool_pose(arm: Arm, frames: Frames, tool: str) -> Pose:
    """Compute X_RT, the pose of a tool in the rover frame, batch (...)."""
    X_FT, R_RF = arm.X_FT[tool], frames.X_RF.R[:, :, 5]
    R_RT = np.einsum("ik...,kj->ij...", R_RF, X_FT.R)
    return Pose(R_RT, np.einsum("ik...,k->i...", R_RF, X_FT.p) + frames.X_RF.p[:, 5])


def joint_jacobian(frames: Frames, p_R_m: Array) -> Array:
    """Compute the Jacobian of a point fixed to the turret by the joint angles.

    The springs are held: their response to the motion is not included.

    Args:
        p_R_m: Point in the rover frame, shape (3, ...).

    Returns:
        Screws per joint rate in the rover frame, rotation [rad/rad] first, then translation [m/rad], shape
        (6, 5, ...).
    """
    axis = frames.X_RL.R[:, 2, 1:]
    return np.concatenate([axis, cross(axis, p_R_m[:, None] - frames.X_RL.p[:, 1:])])


def frame_jacobian(frames: Frames, X_RT: Pose) -> Array:
    """Compute the Jacobian of the tool by small screws of each frame, equations 3 and 7 of the paper.

    A small screw displaces one frame, in its own axes, and all that the frame carries. The springs are held:
    their response to the motion is not included.

    Returns:
        Rotation of the tool and displacement of its origin in rover axes, per screw of each frame, shape (6,
        6, 7, ...), in the order of Frame.
    """
    R_RJ = np.concatenate([frames.X_RF.R, X_RT.R[:, :, None]], axis=2)
    p_RJ_m = np.concatenate([frames.X_RF.p, X_RT.p[:, None]], axis=1)
    return adjoint(Pose(R_RJ, p_RJ_m - X_RT.p[:, None]))


def place_links(
    links: Sequence[Link], output_rad: Sequence[float], strain: Sequence[float]
) -> list[LinkPose]:
    """Place the links: equation 2 of the paper, with a transform for the spring of each link.

    Args:
        strain: Spring displacements in rad and m, rotation first: a value of each link, then the next, 36.
    """
    R: Rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    p: Vector = (0.0, 0.0, 0.0)
    placed = []
    per_link = zip(links, (0.0, *output_rad), *(strain[k : k + 6] for k in range(0, 36, 6)), strict=True)
    for link, angle_rad, rx, ry, rz, tx, ty, tz in per_link:
        theta_rad, (cx, cy, cz), R_CF, p_CF_m, *_ = link
        R_RL = _turn_about_z(R, angle_rad + theta_rad)
        (crx, srx), (cry, sry), (crz, srz) = small_cos_sin(rx), small_cos_sin(ry), small_cos_sin(rz)
        R_LD: Rotation = spring_turn(crx, cry, crz, srx, sry, srz)
        p_LD_m = cx + tx, cy + ty, cz + tz
        p_LF_m = _add(_rotate(R_LD, p_CF_m), p_LD_m)
        p_RL_m, R, p = p, _compose(R_RL, _compose(R_LD, R_CF)), _add(p, _rotate(R_RL, p_LF_m))
        placed.append((R_RL, p_RL_m, R_LD, p_LD_m, R, p))
    return placed


def load_links(
    links: Sequence[Link],
    placed: Sequence[LinkPose],
    gravity_R_m_s2: Vector,
    push: tuple[Vector, Vector] | None = None,
) -> tuple[list[Row], list[float]]:
    """Compute spring strains and joint torques under the load: equations 4 and 5 of the paper.

    Args:
        push: Contact force on the arm in N and the point at which it acts in m, in the rover frame.

    Returns:
        The strain of the spring of each link in rad and m, and the torque of the load about its joint in N m.
    """
    carried_kg, mx, my, mz = 0.0, 0.0, 0.0, 0.0
    strains, torques = [], []
    for link, at in zip(reversed(links), reversed(placed), strict=True):
        _, _, _, _, compliance, near_kg, far_kg, (nx, ny, nz), far_kg_m = link
        R_RL, (px, py, pz), R_LD, (dx, dy, dz), _, _ = at
        # first moments of mass: of the link about its origin, then of all it carries about the rover origin
        fx, fy, fz = _rotate(R_LD, far_kg_m)
        ox, oy, oz = _rotate(R_RL, (fx + far_kg * dx + nx, fy + far_kg * dy + ny, fz + far_kg * dz + nz))
        own_kg, beyond_kg = near_kg + far_kg, carried_kg + far_kg
        carried_kg += own_kg
        mx, my, mz = mx + ox + own_kg * px, my + oy + own_kg * py, mz + oz + own_kg * pz
        # torque about the joint axis in the link frame, then the load on the spring
        gx, gy, gz = _rotate_back(R_RL, gravity_R_m_s2)
        lx, ly, lz = _rotate_back(R_RL, (mx - carried_kg * px, my - carried_kg * py, mz - carried_kg * pz))
        torque = lx * gy - ly * gx
        lx, ly, lz = lx - nx - beyond_kg * dx, ly - ny - beyond_kg * dy, lz - nz - beyond_kg * dz
        moment = ly * gz - lz * gy, lz * gx - lx * gz, lx * gy - ly * gx
        force = beyond_kg * gx, beyond_kg * gy, beyond_kg * gz
        if push is not None:
            push_L, (ax, ay, az) = _rotate_back(R_RL, push[0]), _rotate_back(R_RL, _less(push[1], at[1]))
            torque += ax * push_L[1] - ay * push_L[0]
            moment = _add(moment, _cross((ax - dx, ay - dy, az - dz), push_L))
            force = _add(force, push_L)
        torques.append(torque)
        strains.append(_multiply(compliance, (*spring_moments((R_LD[2], R_LD[5], R_LD[8]), moment), *force)))
    return strains[::-1], torques[::-1]


def spring_turn(
    cx: Number, cy: Number, cz: Number, sx: Number, sy: Number, sz: Number
) -> tuple[Number, Number, Number, Number, Number, Number, Number, Number, Number]:
    """Compute the rotation of springs, row by row, from cosines and sines of their turns about x, y and z.

    Each turn carries the later axes.
    """
    sxsy, cxsy = sx * sy, cx * sy
    row_x = cy * cz, -cy * sz, sy
    row_y = cx * sz + sxsy * cz, cx * cz - sxsy * sz, -sx * cy
    row_z = sx * sz - cxsy * cz, sx * cz + cxsy * sz, cx * cy
    return row_x + row_y + row_z


def spring_moments(
    z_axis: tuple[Number, Number, Number], moment_Nm: tuple[Number, Number, Number]
) -> tuple[Number, Number, Number]:
    """Compute the moments about the axes of springs, of which each turn carries the later ones.

    The axes are x, then y turned about x, then z turned about both.

    Args:
        z_axis: The last of them, the z axis of the far side in the link frame, 3.
        moment_Nm: Moment in the link frame, 3.
    """
    (zx, zy, zz), (mx, my, mz) = z_axis, moment_Nm
    return mx, (zz * my - zy * mz) / (zy * zy + zz * zz) ** 0.5, zx * mx + zy * my + zz * mz


def small_cos_sin(x: Number) -> tuple[Number, Number]:
    """Compute cosine and sine by series, to 3e-13 up to 0.1 rad; numpy takes ten times as long."""
    x2 = x * x
    cosine = 1 - x2 * (1 / 2 - x2 * (1 / 24 - x2 * (1 / 720)))
    sine = x * (1 - x2 * (1 / 6 - x2 * (1 / 120 - x2 * (1 / 5040))))
    return cosine, sine


def _turn_about_z(R: Rotation, angle_rad: float) -> Rotation:
    c, s = cos(angle_rad), sin(angle_rad)
    ax, ay, az, bx, by, bz, cx, cy, cz = R
    return (
        *(ax * c + ay * s, ay * c - ax * s, az),
        *(bx * c + by * s, by * c - bx * s, bz),
        *(cx * c + cy * s, cy * c - cx * s, cz),
    )


def _compose(R: Rotation, S: Rotation) -> Rotation:
    a, b, c, d, e, f, g, h, i = R
    j, k, l, m, n, o, p, q, r = S  # noqa: E741  letters in alphabetical order
    return (
        *(a * j + b * m + c * p, a * k + b * n + c * q, a * l + b * o + c * r),
        *(d * j + e * m + f * p, d * k + e * n + f * q, d * l + e * o + f * r),
        *(g * j + h * m + i * p, g * k + h * n + i * q, g * l + h * o + i * r),
    )


def _rotate(R: Rotation, v: Vector) -> Vector:
    a, b, c, d, e, f, g, h, i = R
    x, y, z = v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _rotate_back(R: Rotation, v: Vector) -> Vector:
    a, b, c, d, e, f, g, h, i = R
    x, y, z = v
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _less(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _multiply(matrix: Sequence[Row], vector: Row) -> Row:
    u, v, w, x, y, z = vector
    p, q, r, s, t, o = [a * u + b * v + c * w + d * x + e * y + f * z for a, b, c, d, e, f in matrix]
    return p, q, r, s, t, o
