"""Closed-form inverse kinematics for a position and an approach axis: eight branches, each said why if out.

The arm's plane holds the three parallel joints. For a radial tool (boresight through the turret axis) the
point of the turret axis behind the target lies at a known lateral offset from that plane: two azimuths
(shoulder out, in). The turret axis is normal to both the pitch axis and the approach: two signs (wrist down,
up). What is left is a planar two-link arm: two elbows.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import Array, rigid, rotation_z, wrap_angle

Flags = NDArray[np.bool_]


class Verdict(IntEnum):
    """Why a branch is in or out."""

    VALID = 0
    OUTSIDE_LIMITS = 1
    OUT_OF_REACH = 2
    SINGULAR = 3


BRANCHES: Final = tuple(
    f"shoulder-{shoulder} elbow-{elbow} wrist-{wrist}"
    for shoulder in ("out", "in")
    for elbow in ("up", "down")
    for wrist in ("up", "down")
)
SINGULAR_SINE: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """The eight answers for each target, in the order of BRANCHES."""

    output_rad: Array
    """(..., 8, 5), NaN where out of reach."""
    verdict: NDArray[np.int64]
    """(..., 8), of Verdict."""
    excess: Array
    """(..., 8): by how much the branch is out: radians over the worst limit, or metres out of reach."""


def closed_form(arm: Arm, tool: int, p_RoTo_R_m: Array, approach_R: Array) -> Branches:
    """All branches of the rigid nominal geometry for positions (..., 3) and unit approach vectors (..., 3).

    Exact for an arm whose axes are square and whose tool is radial; for a calibrated arm the start of
    compensation.refine. Angles are given in the turn that the soft limits allow.
    """
    geometry = _geometry(arm, tool)
    R_1R = geometry.X_R1[:3, :3].T
    p = (R_1R @ (p_RoTo_R_m - geometry.X_R1[:3, 3])[..., None])[..., 0]
    a = (R_1R @ approach_R[..., None])[..., 0]
    axis_point = p - geometry.radius_m * a

    q1, out_shoulder = _azimuths(geometry, axis_point)
    c1, s1 = np.cos(q1), np.sin(q1)
    zeros = np.zeros_like(c1)
    forward_dir = np.stack([c1, s1, zeros], axis=-1)
    pitch_axis = np.stack([s1, -c1, zeros], axis=-1)
    turret_axis, sine = _turret_axes(pitch_axis, a)
    q, out_elbow, elbow_up = _planar(geometry, forward_dir[..., None, :], axis_point, turret_axis)
    q = _complete(q, q1, forward_dir, pitch_axis, turret_axis, a, geometry.clock_rad)

    q = _order_elbows(q, elbow_up)
    # fmax: without an azimuth the elbow's share is NaN, and the shoulder's says how much is missing
    out_of_reach = np.fmax(out_shoulder[..., :, None, None], out_elbow[..., :, None, :])
    singular = np.broadcast_to((sine < SINGULAR_SINE)[..., :, None, None], q.shape[:-1])
    flat = (*q.shape[:-4], 8)
    return _judge(
        arm,
        q.reshape(*flat, 5),
        np.broadcast_to(out_of_reach, q.shape[:-1]).reshape(flat),
        singular.reshape(flat),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Geometry:
    X_R1: Array
    reach_m: float
    upper_m: float
    fore_m: float
    wrist_m: float
    lateral_m: float
    radius_m: float
    along_m: float
    clock_rad: float


def _geometry(arm: Arm, tool: int) -> _Geometry:
    """The lengths of the closed form, read from the chain at zero pose."""
    X_LF = arm.X_CF.copy()
    X_LF[:, :3, 3] += arm.p_LC_m
    X_R1 = rigid(rotation_z(arm.theta_rad[0]), np.zeros(3)) @ X_LF[0]
    p = X_LF[:, :3, 3]
    X_FT = arm.X_FT[tool]
    boresight = X_FT[:3, 0]
    clock = float(np.arctan2(boresight[1], boresight[0]))
    return _Geometry(
        X_R1=X_R1,
        reach_m=p[1, 0],
        upper_m=p[2, 0],
        fore_m=p[3, 0],
        wrist_m=p[4, 0],
        lateral_m=p[2, 2] + p[3, 2] + p[4, 2] - p[1, 1],
        radius_m=float(X_FT[0, 3] * np.cos(clock) + X_FT[1, 3] * np.sin(clock)),
        along_m=p[5, 2] + X_FT[2, 3],
        clock_rad=clock,
    )


def _azimuths(geometry: _Geometry, axis_point: Array) -> tuple[Array, Array]:
    """Shoulder out and in, (..., 2), and how far the point is inside the unreachable cylinder, (..., 2)."""
    x, y = axis_point[..., 0], axis_point[..., 1]
    rho = np.hypot(x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        lean = np.arcsin(geometry.lateral_m / rho)
    heading = np.arctan2(y, x)
    q1 = np.stack([heading + lean, heading + np.pi - lean], axis=-1)
    missing = np.maximum(abs(geometry.lateral_m) - rho, 0.0)
    return q1, np.stack([missing, missing], axis=-1)


def _turret_axes(pitch_axis: Array, a: Array) -> tuple[Array, Array]:
    """Unit turret axes, wrist up and down, (..., 2, 2, 3); sine of pitch axis to approach, (..., 2)."""
    normal = np.cross(pitch_axis, a[..., None, :])
    sine = np.linalg.norm(normal, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = normal / sine[..., None]
    return np.stack([-unit, unit], axis=-2), sine


def _planar(
    geometry: _Geometry, forward_dir: Array, axis_point: Array, turret_axis: Array
) -> tuple[Array, Array, Flags]:
    """Elevation, elbow and wrist for both elbow signs: (..., shoulder, sign, wrist, 5) with 1:4 filled in."""
    sin_pitch = -np.sum(turret_axis * forward_dir, axis=-1)
    pitch = np.arctan2(sin_pitch, turret_axis[..., 2])
    wrist_centre = axis_point[..., None, None, :] - geometry.along_m * turret_axis
    x = np.sum(wrist_centre * forward_dir, axis=-1) - geometry.reach_m - geometry.wrist_m * np.cos(pitch)
    z = wrist_centre[..., 2] - geometry.wrist_m * np.sin(pitch)
    l1, l2 = geometry.upper_m, geometry.fore_m
    distance = np.hypot(x, z)
    out = np.maximum(np.maximum(distance - (l1 + l2), abs(l1 - l2) - distance), 0.0)
    bend = np.arccos(np.clip((distance**2 - l1**2 - l2**2) / (2 * l1 * l2), -1.0, 1.0))
    q3 = np.stack([bend, -bend], axis=-2)
    q2 = np.arctan2(z, x)[..., None, :] - np.arctan2(l2 * np.sin(q3), l1 + l2 * np.cos(q3))
    q = np.empty((*q3.shape, 5))
    q[..., 1] = q2
    q[..., 2] = q3
    q[..., 3] = pitch[..., None, :] - q2 - q3
    return q, out, (x >= 0)


def _complete(
    q: Array, q1: Array, forward_dir: Array, pitch_axis: Array, turret_axis: Array, a: Array, clock_rad: float
) -> Array:
    """Azimuth and turret angles: the turret turns the boresight from the arm's plane to the approach."""
    x5 = np.cross(-pitch_axis[..., None, :], turret_axis)
    turret = np.arctan2(
        -np.sum(a[..., None, None, :] * pitch_axis[..., None, :], axis=-1),
        np.sum(a[..., None, None, :] * x5, axis=-1),
    )
    q[..., 0] = q1[..., :, None, None]
    q[..., 4] = (turret - clock_rad)[..., :, None, :]
    return q


def _order_elbows(q: Array, ahead: Flags) -> Array:
    """Elbow up first: positive bend where the wrist is ahead of the shoulder, negative where it is behind."""
    swap = ~ahead[..., :, None, :, None]
    ordered: Array = np.where(swap, q[..., ::-1, :, :], q)
    return ordered


def _judge(arm: Arm, q: Array, out_of_reach_m: Array, singular: Flags) -> Branches:
    q = into_limits(arm, q - arm.theta_rad[1:])
    over = np.max(np.maximum(arm.soft_min_rad - q, q - arm.soft_max_rad), axis=-1)
    verdict = np.where(over > 0, Verdict.OUTSIDE_LIMITS, Verdict.VALID)
    excess = np.fmax(over, 0.0)
    verdict = np.where(singular, Verdict.SINGULAR, verdict)
    verdict = np.where(out_of_reach_m > 0, Verdict.OUT_OF_REACH, verdict)
    excess = np.where(out_of_reach_m > 0, out_of_reach_m, excess)
    lost = verdict >= Verdict.OUT_OF_REACH
    return Branches(np.where(lost[..., None], np.nan, q), verdict, excess)


def into_limits(arm: Arm, q: Array, near_rad: Array | None = None) -> Array:
    """The same angles (..., 5) in the turn inside the soft limits, the nearest to `near_rad` if two fit.

    Where no turn fits, the turn nearest to the middle of the range.
    """
    middle = 0.5 * (arm.soft_min_rad + arm.soft_max_rad)
    near = middle if near_rad is None else near_rad
    best = near + wrap_angle(q - near)
    inside = (best >= arm.soft_min_rad) & (best <= arm.soft_max_rad)
    return np.where(inside, best, middle + wrap_angle(q - middle))
