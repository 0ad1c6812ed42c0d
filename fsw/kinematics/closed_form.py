"""Closed-form inverse kinematics of the orthogonal rigid arm for position and approach, by branch.

The plane of the arm holds the three parallel joints. The turret axis is normal to the pitch axis and makes a
fixed angle with the approach. This gives two directions: wrist down and up. The wrist centre has a known
lateral offset from the plane. This gives two azimuths: shoulder out and in. The rest is a planar two-link
arm, with two elbows.

In all functions, `q1` are azimuths in rad, constant turn included, `sine` the sines of the wrist, `t_e` and
`t_z` the forward and downward components of the turret axis, a unit vector; shape (...). Vectors in the rover
frame and in frame Arm1 have shape (3, ...); in the plane of the arm they are `InPlane`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm, OrthogonalArm
from fsw.kinematics.azimuth import (
    solve_azimuth_near,
    solve_azimuths,
    solve_offset_azimuth_near,
    solve_offset_azimuths,
)
from fsw.kinematics.transforms import Array, Integers, record_arrays, rotate_back

BRANCHES: Final = tuple(
    f"shoulder-{shoulder} elbow-{elbow} wrist-{wrist}"
    for shoulder in ("out", "in")
    for elbow in ("up", "down")
    for wrist in ("up", "down")
)
"""Names of the eight branches, in the order of the slots."""


def fold_distances(s: OrthogonalArm, output_rad: Array) -> Array:
    """Compute signed distances of poses from the folds of shoulder, elbow and wrist.

    A negative value means out, up, up. The shoulder's value is the distance [m] of the turret axis' foot
    behind the azimuth axis. The elbow's value is the sine of its bend, negative above the line from shoulder
    to wrist. The wrist's value is the sine of the turret axis against the approach. The elbow also changes
    its name, without a fold, where the wrist joint passes over or under the elevation joint.

    Returns:
        Distances of shoulder [m], elbow and wrist [sine], shape (3, ...).
    """
    q = output_rad + s.theta_rad.reshape(5, *(1,) * (output_rad.ndim - 1))
    upper, fore = q[Joint.ELEVATION], q[Joint.ELEVATION] + q[Joint.ELBOW]
    pitch = fore + q[Joint.WRIST]
    x = s.upper_m * np.cos(upper) + s.fore_m * np.cos(fore)
    ahead = s.out_m + x + s.wrist_m * np.cos(pitch) - s.along_m * np.sin(pitch)
    elbow = np.sin(q[Joint.ELBOW])
    return np.stack([-ahead, np.where(x >= 0, -elbow, elbow), np.cos(q[Joint.TURRET] + s.clock_rad)])


def branch_index(signs: Array) -> Integers:
    """Compute indices into BRANCHES, (...), from fold distances or numbers of the same sign, (3, ...)."""
    index: Integers = (signs >= 0).astype(np.int64).T @ np.array([4, 2, 1])
    return index.T


FREE_SINE: Final = 1e-7
"""Below it the approach is parallel to the pitch axes within rounding: the wrist pitch is free."""
SQUARED_ROUNDING: Final = 1e-14
"""Rounding error of a difference of squared cosines."""
InPlane = tuple[Array, Array, Array]
"""Components of a vector in the plane of the arm: forward, along the pitch axis, down."""


@dataclass(frozen=True, slots=True, eq=False)
class Roots:
    """Eight roots of each target, batch axes trailing, in the order of BRANCHES.

    For a tool with an offset, one branch may have two roots and another none. The order is then by wrist, and
    within a wrist by the forward position of the foot.
    """

    output_rad: Array
    """Output angles, (5, 8, ...); for a target out of reach, the nearest pose of this construction."""
    missing_m: Array
    """Distance by which the target is out of reach, 0 if it is in reach, (8, ...)."""
    wrist_sine: Array
    """Sine between approach and pitch axes, (8, ...); at 0 the wrist pitch is free."""
    from_fold: Array
    """Distances from the folds of shoulder [m], elbow and wrist [sine], where roots meet, (3, 8, ...)."""


def closed_form(
    arm: Arm, tool: str, p_RoTo_R_m: Array, approach_R: Array, least_bend_rad: float = 0.0
) -> Roots:
    """Compute all eight roots of the orthogonal rigid arm for each target.

    The roots are exact for an orthogonal arm with any tool. For a calibrated arm they are starting points.

    Args:
        least_bend_rad: Least distance of the elbow from straight and folded, where two roots meet.
    """
    s = arm.orthogonal[tool]
    p, a = to_shoulder_frame(s, p_RoTo_R_m, approach_R)
    foot = p - s.radius_m * a
    find = solve_azimuths if s.offset_m == 0.0 else solve_offset_azimuths
    q1, sine, missing_shoulder = find(s, foot, a)  # (shoulder, wrist, ...)
    foot_P, a_P = to_arm_plane(q1, foot, a)
    t_e, t_z, missing_axis = turret_axis(s, a_P, sine)
    reach = locate_wrist(s, foot_P, a_P, t_e, t_z)
    bend = np.clip(reach.bend_rad, least_bend_rad, np.pi - least_bend_rad)
    bend_up = np.where(reach.x_m >= 0, bend, -bend)
    bend = np.stack([bend_up, -bend_up], axis=1)  # (shoulder, elbow, wrist, ...)
    signed_reach = Reach(reach.x_m[:, None], reach.z_m[:, None], bend, reach.missing_m[:, None])
    q = joint_angles(s, a_P[1][:, None], q1[:, None], t_e[:, None], t_z[:, None], sine[:, None], signed_reach)
    missing_elbow = reach.missing_m
    free = np.abs(sine) < FREE_SINE
    if free.any():
        missing_elbow = np.where(free, _circle_shortfall(s, foot_P, a_P), missing_elbow)
    missing = np.maximum(np.maximum(missing_shoulder, missing_axis), missing_elbow)
    from_fold = np.empty((3, *bend.shape))
    from_fold[0] = np.abs(reach.x_m + s.out_m + s.wrist_m * t_z + s.along_m * t_e)[:, None]
    from_fold[1] = np.abs(np.sin(bend))
    from_fold[2] = np.abs(sine)[:, None]
    flat = (8, *q.shape[4:])
    roots = Roots(
        q.reshape(5, *flat),
        np.broadcast_to(missing[:, None], bend.shape).reshape(flat),
        from_fold[2].reshape(flat),
        from_fold.reshape(3, *flat),
    )
    return roots if s.offset_m == 0.0 else _order_by_branch(s, roots)


def _order_by_branch(s: OrthogonalArm, roots: Roots) -> Roots:
    """Sort the roots by branch if each of the eight is on a different branch; else keep their order."""
    branch = branch_index(fold_distances(s, roots.output_rad))
    each = np.broadcast_to(np.arange(8).reshape(8, *(1,) * (branch.ndim - 1)), branch.shape)
    order = np.where(np.all(np.sort(branch, axis=0) == each, axis=0), np.argsort(branch, axis=0), each)
    return Roots(
        *(
            np.take_along_axis(v, np.broadcast_to(order, v.shape), axis=-order.ndim)
            for v in record_arrays(roots)
        )
    )


def closed_form_branch(
    s: OrthogonalArm, p_RoTo_R_m: Array, approach_R: Array, near_rad: Array
) -> tuple[Array, Array]:
    """Compute the root of each target, (5, n) [rad], on the branch of a pose, (5, n).

    The second array is the distance [m] by which the target is out of reach, (n,).
    """
    p, a = to_shoulder_frame(s, p_RoTo_R_m, approach_R)
    near = near_rad + s.theta_rad[:, None]
    foot = p - s.radius_m * a
    wrist = np.copysign(1.0, np.cos(near[4] + s.clock_rad))
    find = solve_azimuth_near if s.offset_m == 0.0 else solve_offset_azimuth_near
    q1, sine, missing_shoulder = find(s, foot, a, wrist, near[0])
    foot_P, a_P = to_arm_plane(q1, foot, a)
    t_e, t_z, missing_axis = turret_axis(s, a_P, sine)
    reach = locate_wrist(s, foot_P, a_P, t_e, t_z)
    bend = np.copysign(reach.bend_rad, np.sin(near[2]))
    bent = Reach(reach.x_m, reach.z_m, bend, reach.missing_m)
    q = joint_angles(s, a_P[1], q1, t_e, t_z, sine, bent)
    return q, np.maximum(np.maximum(missing_shoulder, missing_axis), reach.missing_m)


def to_shoulder_frame(s: OrthogonalArm, p_R_m: Array, v_R: Array) -> tuple[Array, Array]:
    """Transform points [m] and directions into frame Arm1, about whose z the azimuth turns, (3, ...) each."""
    batch = (1,) * (p_R_m.ndim - 1)
    R, p = s.X_R1.R.reshape(3, 3, *batch), s.X_R1.p.reshape(3, *batch)
    return rotate_back(R, p_R_m - p), rotate_back(R, v_R)


def to_arm_plane(q1: Array, *vectors: Array) -> tuple[InPlane, ...]:
    """Resolve vectors in the plane of the arm: forward, along the pitch axis and down."""
    c, s = np.cos(q1), np.sin(q1)
    return tuple((v[0] * c + v[1] * s, v[0] * s - v[1] * c, v[2]) for v in vectors)


def turret_axis(s: OrthogonalArm, a: InPlane, sine: Array) -> tuple[Array, Array, Array]:
    """Compute the turret axis in the plane of the arm: forward, down, and the cosine by which none exists.

    The axis is z5 = (bz a_flat + sine n x a) / flat^2. n is the pitch axis, a_flat the part of the approach
    in the plane, and bz the cosine of boresight and turret axis. Each is of shape (...).
    """
    a_e, _, a_z = a
    flat2 = np.maximum(a_e * a_e + a_z * a_z, 1e-300)  # 1 - a_n^2 would lose half the digits near 0
    t_e = (s.boresight_z * a_e - sine * a_z) / flat2
    t_z = (s.boresight_z * a_z + sine * a_e) / flat2
    if s.offset_m == 0.0 and s.boresight_z == 0.0:
        return t_e, t_z, np.zeros(())
    missing = np.sqrt(np.maximum(s.boresight_z**2 - flat2 - SQUARED_ROUNDING, 0.0))
    length = np.maximum(np.hypot(t_e, t_z), 1e-300)
    return t_e / length, t_z / length, missing


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Wrist joint seen from the elevation joint in the plane of the arm, and the elbow that reaches it."""

    x_m: Array
    """Forward position, (...)."""
    z_m: Array
    """Downward position, (...)."""
    bend_rad: Array
    """Bend of the elbow, (...)."""
    missing_m: Array
    """Distance by which the wrist joint is out of reach, (...); the elbow is then straight or folded."""


def locate_wrist(s: OrthogonalArm, foot: InPlane, b: InPlane, t_e: Array, t_z: Array) -> Reach:
    """Locate the wrist joint and compute the bend of the elbow without its sign."""
    b_n = b[1]
    # wrist centre = foot - offset (z5 x b) - along z5, in the plane
    x = foot[0] - s.offset_m * b_n * t_z - s.along_m * t_e - s.out_m - s.wrist_m * t_z
    z = foot[2] + s.offset_m * b_n * t_e - s.along_m * t_z - s.down_m + s.wrist_m * t_e
    distance2 = x * x + z * z
    distance = np.sqrt(distance2)
    longest, shortest = s.upper_m + s.fore_m, abs(s.upper_m - s.fore_m)
    missing = np.maximum(np.maximum(distance - longest, shortest - distance), 0.0)
    cosine = (distance2 - s.upper_m**2 - s.fore_m**2) / (2 * s.upper_m * s.fore_m)
    return Reach(x, z, np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0)), missing)


def _circle_shortfall(s: OrthogonalArm, foot: InPlane, b: InPlane) -> Array:
    """Compute how far the wrist joint is out of reach for every direction of the turret axis."""
    radius = np.hypot(s.along_m, s.wrist_m + s.offset_m * b[1])
    centre = np.hypot(foot[0] - s.out_m, foot[2] - s.down_m)
    longest, shortest = s.upper_m + s.fore_m, abs(s.upper_m - s.fore_m)
    missing: Array = np.maximum(
        np.maximum(np.abs(centre - radius) - longest, shortest - centre - radius), 0.0
    )
    return missing


def joint_angles(
    s: OrthogonalArm, b_n: Array, q1: Array, t_e: Array, t_z: Array, sine: Array, reach: Reach
) -> Array:
    """Compute the output angles, (5, ...) [rad], from the geometry in the plane of the arm."""
    lean = np.arctan2(s.fore_m * np.sin(reach.bend_rad), s.upper_m + s.fore_m * np.cos(reach.bend_rad))
    q = np.empty((5, *lean.shape))
    q[0] = q1
    q[1] = np.arctan2(reach.z_m, reach.x_m) - lean
    q[2] = reach.bend_rad
    q[3] = np.arctan2(-t_e, t_z) - q[1] - q[2]
    q[4] = np.arctan2(-b_n, sine) - s.clock_rad
    q -= s.theta_rad.reshape(5, *(1,) * lean.ndim)
    return q
