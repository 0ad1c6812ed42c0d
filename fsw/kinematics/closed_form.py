"""Closed-form inverse kinematics for a position and an approach axis: eight roots.

The arm's plane holds the three parallel joints. The turret axis is normal to the pitch axis and makes a
fixed angle with the approach: two directions (wrist down, up). The turret's centre is at a known lateral
offset from the plane: two azimuths (shoulder out, in), in one step for a radial tool, by Newton steps in the
azimuth alone for a tool whose boresight passes the turret axis at a distance. What is left is a planar
two-link arm: two elbows.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.shape import Shape
from fsw.kinematics.transforms import Array, rotate_back

BRANCHES: Final = tuple(
    f"shoulder-{shoulder} elbow-{elbow} wrist-{wrist}"
    for shoulder in ("out", "in")
    for elbow in ("up", "down")
    for wrist in ("up", "down")
)
AZIMUTH_STEPS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class Roots:
    """The eight roots of each target in the order of BRANCHES, batch axes trailing."""

    output_rad: Array
    """(5, 8, ...); where a target is out of reach, the pose that comes nearest in this construction."""
    missing_m: Array
    """(8, ...): by how much the target is out of reach, 0 within."""
    wrist_sine: Array
    """(8, ...): how far the approach is from parallel to the pitch axes; at 0 the wrist pitch is free."""


def closed_form(
    arm: Arm, tool: int, p_RoTo_R_m: Array, approach_R: Array, min_bend_rad: float = 0.0
) -> Roots:
    """All roots of the square rigid arm for positions (3, ...) and unit approach vectors (3, ...).

    Exact for an arm whose axes are square, whatever the tool; for a calibrated arm, the place to start from.
    `min_bend_rad` keeps the elbow that far from straight and folded, where two roots meet.
    """
    s = arm.shapes[tool]
    batch = (1,) * (p_RoTo_R_m.ndim - 1)
    p = rotate_back(s.X_R1.R.reshape(3, 3, *batch), p_RoTo_R_m - s.X_R1.p.reshape(3, *batch))
    a = rotate_back(s.X_R1.R.reshape(3, 3, *batch), approach_R)
    foot = p - s.radius_m * a

    sign = np.array([-1.0, 1.0]).reshape(1, 2, *batch)
    q1, missing_shoulder = _azimuths(s, foot, a, sign)
    c1, s1 = np.cos(q1), np.sin(q1)
    # n pitch axis, e forward in the plane, z down; a_n and so on are components of the approach
    a_n, a_e, a_z = a[0] * s1 - a[1] * c1, a[0] * c1 + a[1] * s1, a[2]
    flat2 = np.maximum(a_e * a_e + a_z * a_z, 1e-300)  # not 1 - a_n^2, which loses half the digits near 0
    sine2 = flat2 - s.boresight_z**2
    sine = sign * np.sqrt(np.maximum(sine2, 0.0))
    # turret axis z5 = bz a_flat / flat^2 + sine (n x a) / flat^2, in the plane: (e, z)
    t_e = (s.boresight_z * a_e - sine * a_z) / flat2
    t_z = (s.boresight_z * a_z + sine * a_e) / flat2
    # wrist centre = foot - offset (z5 x a) - along z5, in the plane
    f_e = foot[0] * c1 + foot[1] * s1
    w_e = f_e - s.offset_m * a_n * t_z - s.along_m * t_e
    w_z = foot[2] + s.offset_m * a_n * t_e - s.along_m * t_z

    x = w_e - s.out_m - s.wrist_m * t_z
    z = w_z - s.down_m + s.wrist_m * t_e
    bend, missing_elbow = _bend(s, x, z, min_bend_rad)
    up = np.where(x >= 0, bend, -bend)
    q3 = np.stack([up, -up], axis=1)
    reach = np.arctan2(s.fore_m * np.sin(bend), s.upper_m + s.fore_m * np.cos(bend))
    q2 = np.arctan2(z, x)[:, None] - np.sign(q3) * reach[:, None]
    pitch = np.arctan2(-t_e, t_z)[:, None]
    q = np.empty((5, *q3.shape))
    q[0] = q1[:, None]
    q[1], q[2], q[3] = q2, q3, pitch - q2 - q3
    q[4] = (np.arctan2(-a_n, sine) - s.clock_rad)[:, None]
    q -= s.theta_rad.reshape(5, 1, 1, 1, *batch)

    missing_axis = np.sqrt(np.maximum(-sine2, 0.0))
    missing = np.maximum(np.maximum(missing_shoulder, missing_elbow), missing_axis)
    flat = (8, *q.shape[4:])
    both = (2, 2, 2, *q.shape[4:])
    return Roots(
        q.reshape(5, *flat),
        np.broadcast_to(missing[:, None], both).reshape(flat),
        np.broadcast_to(np.abs(sine)[:, None], both).reshape(flat),
    )


def _azimuths(s: Shape, foot: Array, a: Array, sign: Array) -> tuple[Array, Array]:
    """Azimuths (shoulder, wrist, ...) that put the wrist centre at its lateral offset, and what is missing.

    The condition is rho sin(q1 - heading) + offset a.x5 = lateral, with a.x5 the signed sine of the wrist.
    """
    rho = np.hypot(foot[0], foot[1])
    heading = np.arctan2(foot[1], foot[0])
    lean = np.arcsin(np.clip(s.lateral_m / np.maximum(rho, 1e-12), -1.0, 1.0))
    q1 = np.stack([heading + lean, heading + np.pi - lean])[:, None] + np.zeros_like(sign)
    missing = np.maximum(abs(s.lateral_m) - rho, 0.0) + np.zeros_like(q1)
    if s.offset_m == 0.0:
        return q1, missing
    for _ in range(AZIMUTH_STEPS):
        error, slope = _lateral_error(s, foot, a, sign, q1)
        q1 = q1 - np.clip(error / np.where(np.abs(slope) < 1e-9, 1e-9, slope), -0.5, 0.5)
    error, _ = _lateral_error(s, foot, a, sign, q1)
    return q1, np.maximum(np.abs(error) - 1e-12, 0.0)


def _lateral_error(s: Shape, foot: Array, a: Array, sign: Array, q1: Array) -> tuple[Array, Array]:
    """By how much the wrist centre misses its lateral offset, and the derivative by the azimuth."""
    c1, s1 = np.cos(q1), np.sin(q1)
    a_n, a_e = a[0] * s1 - a[1] * c1, a[0] * c1 + a[1] * s1
    sine = np.sqrt(np.maximum(a_e * a_e + a[2] * a[2] - s.boresight_z**2, 1e-18))
    f_n, f_e = foot[0] * s1 - foot[1] * c1, foot[0] * c1 + foot[1] * s1
    return f_n + s.offset_m * sign * sine - s.lateral_m, f_e - s.offset_m * sign * a_n * a_e / sine


def _bend(s: Shape, x: Array, z: Array, min_bend_rad: float) -> tuple[Array, Array]:
    """The elbow's bend, without its sign, for a wrist joint at (x, z), and by how much it is out of reach."""
    distance2 = x * x + z * z
    distance = np.sqrt(distance2)
    longest, shortest = s.upper_m + s.fore_m, abs(s.upper_m - s.fore_m)
    missing = np.maximum(np.maximum(distance - longest, shortest - distance), 0.0)
    cosine = (distance2 - s.upper_m**2 - s.fore_m**2) / (2 * s.upper_m * s.fore_m)
    bend = np.arccos(np.clip(cosine, -1.0, 1.0))
    if min_bend_rad > 0.0:
        bend = np.clip(bend, min_bend_rad, np.pi - min_bend_rad)
    return bend, missing
