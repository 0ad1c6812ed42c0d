"""Closed-form inverse kinematics of the square rigid arm for a position and an approach axis: eight roots.

The arm's plane holds the three parallel joints. The turret axis is normal to the pitch axis and makes a
fixed angle with the approach: two directions (wrist down, up). The wrist centre is at a known lateral offset
from the plane: two azimuths (shoulder out, in), in one step for a radial tool; for a tool whose boresight
passes the turret axis at a distance, the azimuths of both wrists together are the four roots of one
trigonometric polynomial. What is left is a planar two-link arm: two elbows.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm, OrthogonalArm
from fsw.kinematics.batch import record_arrays
from fsw.kinematics.branches import branch_index, fold_distances
from fsw.kinematics.transforms import Array, rotate_back

NEAR_CIRCLE: Final = 1e-3
"""Eigenvalues this close to the unit circle are tried as angles."""
POLISHING_STEPS: Final = 4
SMALL_SINE2: Final = 1e-6
"""Below it the root of sine^2 has lost its digits, and the sine follows from the lateral condition."""
ROUNDING_M: Final = 1e-12
ROUNDING_M2: Final = 1e-14
"""What is left of arithmetic in a length, and in a difference of squares of lengths."""

WRISTS: Final = np.array([-1.0, 1.0])


def solve_azimuths(s: OrthogonalArm, foot: Array, a: Array) -> tuple[Array, Array, Array]:
    """Azimuths for a radial tool, sines of the wrist, what is missing [m]: (shoulder, wrist, ...) each."""
    lean, heading, missing = _lean(s, foot)
    q1 = np.stack([heading + lean, heading + np.pi - lean])[:, None]
    wrist = WRISTS.reshape(1, 2, *(1,) * heading.ndim)
    sine = wrist * np.sqrt(np.maximum(_sine2(s, a, q1), 0.0))
    return np.broadcast_to(q1, sine.shape), sine, np.broadcast_to(missing, sine.shape)


def solve_azimuth_near(
    s: OrthogonalArm, foot: Array, a: Array, wrist: Array, near_rad: Array
) -> tuple[Array, Array, Array]:
    """Likewise, (n,) each, on the side of the azimuths `near_rad` and the wrists with these signs."""
    lean, heading, missing = _lean(s, foot)
    ahead = foot[0] * np.cos(near_rad) + foot[1] * np.sin(near_rad) >= 0
    q1 = heading + np.where(ahead, lean, np.pi - lean)
    return q1, wrist * np.sqrt(np.maximum(_sine2(s, a, q1), 0.0)), missing


def _lean(s: OrthogonalArm, foot: Array) -> tuple[Array, Array, Array]:
    """Angle between the foot and the arm's plane, heading of the foot, and what is missing."""
    rho = np.hypot(foot[0], foot[1])
    lean = np.arcsin(np.clip(s.lateral_m / np.maximum(rho, 1e-300), -1.0, 1.0))
    return lean, np.arctan2(foot[1], foot[0]), np.maximum(abs(s.lateral_m) - rho, 0.0)


def solve_offset_azimuths(s: OrthogonalArm, foot: Array, a: Array) -> tuple[Array, Array, Array]:
    """As azimuths, for a tool with an offset.

    Squared, the condition is a trigonometric polynomial of degree two: its four roots, of both wrists
    together, are eigenvalues of a companion matrix. Those on the unit circle are polished.
    """
    z = np.linalg.eigvals(_companion(s, foot, a))
    q1: Array = np.moveaxis(np.angle(z), -1, 0).astype(np.float64)
    wrist = np.where(s.offset_m * (s.lateral_m - _lateral(foot, q1)) >= 0, 1.0, -1.0)
    is_angle = np.moveaxis(np.abs(np.abs(z) - 1.0) < NEAR_CIRCLE, -1, 0)
    for _ in range(POLISHING_STEPS):
        step = np.clip(_newton_step(s, foot, a, wrist, q1), -NEAR_CIRCLE, NEAR_CIRCLE)
        q1 = q1 - np.where(is_angle, step, 0.0)
    sine, missing = _offset_sine(s, foot, a, wrist, q1)
    # by wrist, then from shoulder out to shoulder in
    forward = foot[0] * np.cos(q1) + foot[1] * np.sin(q1)
    order = np.lexsort((-forward, wrist), axis=0)
    q1, sine, missing = (_in_pairs(np.take_along_axis(v, order, axis=0)) for v in (q1, sine, missing))
    return q1, sine, missing


def solve_offset_azimuth_near(
    s: OrthogonalArm, foot: Array, a: Array, wrist: Array, near_rad: Array
) -> tuple[Array, Array, Array]:
    """As azimuth_near, for a tool with an offset: where Newton steps lead."""
    q1 = near_rad
    for _ in range(POLISHING_STEPS):
        q1 = q1 - np.clip(_newton_step(s, foot, a, wrist, q1), -0.1, 0.1)
    return q1, *_offset_sine(s, foot, a, wrist, q1)


def _in_pairs(values: Array) -> Array:
    """(4, ...), ordered by wrist and then by shoulder, as (shoulder, wrist, ...)."""
    return np.swapaxes(values.reshape(2, 2, *values.shape[1:]), 0, 1)


def _companion(s: OrthogonalArm, foot: Array, a: Array) -> NDArray[np.complex128]:
    """(..., 4, 4), with the eigenvalues exp(i q1)."""
    # lateral position and a_n are the imaginary parts of u z and v z, with z = exp(i q1)
    u, v = foot[0] - 1j * foot[1], a[0] - 1j * a[1]
    d2 = s.offset_m**2
    # (lateral - Im(u z))^2 - d2 (1 - bz^2 - Im(v z)^2), times z^2
    c4 = -(u * u + d2 * v * v) / 4
    c3 = 1j * s.lateral_m * u
    c2 = s.lateral_m**2 - d2 * (1 - s.boresight_z**2) + (np.abs(u) ** 2 + d2 * np.abs(v) ** 2) / 2
    least = 1e-14 * (np.abs(u) ** 2 + d2)
    c4 = np.where(np.abs(c4) < least, least, c4)
    matrix = np.zeros((*u.shape, 4, 4), np.complex128)
    matrix[..., 1, 0] = matrix[..., 2, 1] = matrix[..., 3, 2] = 1.0
    for row, c in enumerate((np.conj(c4), np.conj(c3), c2, c3)):
        matrix[..., row, 3] = -c / c4
    return matrix


def _lateral(foot: Array, q1: Array) -> Array:
    lateral: Array = foot[0] * np.sin(q1) - foot[1] * np.cos(q1)
    return lateral


def _sine2(s: OrthogonalArm, a: Array, q1: Array) -> Array:
    """1 - bz^2 - a_n^2, without the cancellation near 0 of a radial tool."""
    forward = a[0] * np.cos(q1) + a[1] * np.sin(q1)
    sine2: Array = forward * forward + a[2] * a[2] - s.boresight_z**2
    return sine2


def _offset_sine(s: OrthogonalArm, foot: Array, a: Array, wrist: Array, q1: Array) -> tuple[Array, Array]:
    """The sine of the wrist, and by how much the lateral condition is missed [m]."""
    sine2, short = _sine2(s, a, q1), s.lateral_m - _lateral(foot, q1)
    sine = wrist * np.sqrt(np.maximum(sine2, 0.0))
    small = np.abs(sine2) < SMALL_SINE2
    squared = np.abs(short * short - s.offset_m**2 * sine2)
    missing = np.abs(s.offset_m * sine - short)
    missing = np.where(small, np.where(squared < ROUNDING_M2, 0.0, np.sqrt(squared)), missing)
    return np.where(small, short / s.offset_m, sine), np.where(missing < ROUNDING_M, 0.0, missing)


def _newton_step(s: OrthogonalArm, foot: Array, a: Array, wrist: Array, q1: Array) -> Array:
    """The Newton step of the condition; where the sine is small, of its square, which is smooth there."""
    c1, s1 = np.cos(q1), np.sin(q1)
    a_n, a_e = a[0] * s1 - a[1] * c1, a[0] * c1 + a[1] * s1
    forward = foot[0] * c1 + foot[1] * s1
    short, sine2 = s.lateral_m - _lateral(foot, q1), _sine2(s, a, q1)
    sine = wrist * np.sqrt(np.maximum(sine2, SMALL_SINE2))
    plain = _ratio(s.offset_m * sine - short, forward - s.offset_m * a_n * a_e / sine)
    d2 = s.offset_m**2
    squared = _ratio(short * short - d2 * sine2, 2 * (d2 * a_n * a_e - short * forward))
    return np.where(sine2 < SMALL_SINE2, squared, plain)


def _ratio(value: Array, slope: Array) -> Array:
    ratio: Array = value / np.where(np.abs(slope) < 1e-12, 1e-12, slope)
    return ratio


InPlane = tuple[Array, Array, Array]
"""Components of a vector as seen from the arm's plane: forward, along the pitch axis, down."""

FREE_SINE: Final = 1e-7
"""An approach this close to parallel to the pitch axes leaves the wrist pitch free, within rounding."""
SQUARED_ROUNDING: Final = 1e-14
"""What is left of arithmetic in a difference of squares of cosines."""


@dataclass(frozen=True, slots=True, eq=False)
class Roots:
    """The eight roots of each target, batch axes trailing, in the order of BRANCHES.

    With a boresight that misses the turret axis one branch may have two roots and another none; then the
    azimuths are ordered by wrist, and of a wrist by how far ahead they put the foot on the turret axis.
    """

    output_rad: Array
    """(5, 8, ...); where a target is out of reach, the pose that comes nearest in this construction."""
    missing_m: Array
    """(8, ...): by how much the target is out of reach, 0 within."""
    wrist_sine: Array
    """(8, ...): how far the approach is from parallel to the pitch axes; at 0 the wrist pitch is free."""
    from_fold: Array
    """(3, 8, ...): how far from the folds of shoulder [m], elbow and wrist [sine], where roots meet."""


def closed_form(
    arm: Arm, tool: int, p_RoTo_R_m: Array, approach_R: Array, least_bend_rad: float = 0.0
) -> Roots:
    """All roots of the square rigid arm for positions (3, ...) and unit approach vectors (3, ...).

    Exact for an arm whose axes are square, whatever the tool; for a calibrated arm, the place to start from.
    `least_bend_rad` keeps the elbow that far from straight and folded, where two roots meet.
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
    up = np.where(reach.x_m >= 0, bend, -bend)
    bend = np.stack([up, -up], axis=1)  # (shoulder, elbow, wrist, ...)
    both = Reach(reach.x_m[:, None], reach.z_m[:, None], bend, reach.missing_m[:, None])
    q = joint_angles(s, a_P[1][:, None], q1[:, None], t_e[:, None], t_z[:, None], sine[:, None], both)
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
    """The roots in the order of BRANCHES, where each of the eight is on another branch; else as they are."""
    name = branch_index(fold_distances(s, roots.output_rad))
    each = np.broadcast_to(np.arange(8).reshape(8, *(1,) * (name.ndim - 1)), name.shape)
    order = np.where(np.all(np.sort(name, axis=0) == each, axis=0), np.argsort(name, axis=0), each)
    return Roots(
        *(
            np.take_along_axis(v, np.broadcast_to(order, v.shape), axis=-order.ndim)
            for v in record_arrays(roots)
        )
    )


def closed_form_branch(
    s: OrthogonalArm, p_RoTo_R_m: Array, approach_R: Array, near_rad: Array
) -> tuple[Array, Array]:
    """The roots (5, n) of targets (3, n) on the branches of the poses `near_rad`, and what is missing."""
    p, a = to_shoulder_frame(s, p_RoTo_R_m, approach_R)
    near = near_rad + s.theta_rad[:, None]
    foot = p - s.radius_m * a
    wrist = np.where(np.cos(near[4] + s.clock_rad) >= 0, 1.0, -1.0)
    find = solve_azimuth_near if s.offset_m == 0.0 else solve_offset_azimuth_near
    q1, sine, missing_shoulder = find(s, foot, a, wrist, near[0])
    foot_P, a_P = to_arm_plane(q1, foot, a)
    t_e, t_z, missing_axis = turret_axis(s, a_P, sine)
    reach = locate_wrist(s, foot_P, a_P, t_e, t_z)
    bend = np.where(np.sin(near[2]) >= 0, reach.bend_rad, -reach.bend_rad)
    q = joint_angles(s, a_P[1], q1, t_e, t_z, sine, replace(reach, bend_rad=bend))
    return q, np.maximum(np.maximum(missing_shoulder, missing_axis), reach.missing_m)


def to_shoulder_frame(s: OrthogonalArm, p_R_m: Array, v_R: Array) -> tuple[Array, Array]:
    """Points and directions (3, ...) of the rover frame in frame Arm1, in which the azimuth turns about z."""
    batch = (1,) * (p_R_m.ndim - 1)
    R, p = s.X_R1.R.reshape(3, 3, *batch), s.X_R1.p.reshape(3, *batch)
    return rotate_back(R, p_R_m - p), rotate_back(R, v_R)


def to_arm_plane(q1: Array, *vectors: Array) -> tuple[InPlane, ...]:
    """Vectors (3, ...) of frame Arm1 as seen from the arm's plane at some azimuths."""
    c, s = np.cos(q1), np.sin(q1)
    return tuple((v[0] * c + v[1] * s, v[0] * s - v[1] * c, v[2]) for v in vectors)


def turret_axis(s: OrthogonalArm, a: InPlane, sine: Array) -> tuple[Array, Array, Array]:
    """Turret axis in the arm's plane, forward and down, and by how much there is none.

    The axis is z5 = (bz a_flat + sine n x a) / flat^2, with n the pitch axis, a_flat the approach's part in
    the plane and bz the cosine of boresight and turret axis.
    """
    a_e, _, a_z = a
    flat2 = np.maximum(a_e * a_e + a_z * a_z, 1e-300)  # not 1 - a_n^2, which loses half the digits near 0
    t_e = (s.boresight_z * a_e - sine * a_z) / flat2
    t_z = (s.boresight_z * a_z + sine * a_e) / flat2
    if s.offset_m == 0.0 and s.boresight_z == 0.0:
        return t_e, t_z, np.zeros(())
    missing = np.sqrt(np.maximum(s.boresight_z**2 - flat2 - SQUARED_ROUNDING, 0.0))
    length = np.maximum(np.hypot(t_e, t_z), 1e-300)
    return t_e / length, t_z / length, missing


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """The wrist joint as seen from the elevation joint, in the arm's plane, and the elbow that reaches it."""

    x_m: Array
    """Forward."""
    z_m: Array
    """Down."""
    bend_rad: Array
    missing_m: Array
    """By how much it is out of reach; the elbow is then straight or folded."""


def locate_wrist(s: OrthogonalArm, foot: InPlane, b: InPlane, t_e: Array, t_z: Array) -> Reach:
    """Where the wrist joint has to be for a foot on the turret axis, a boresight b and a turret axis.

    The bend is without its sign.
    """
    b_n = b[1]
    # wrist centre = foot - offset (z5 x b) - along z5, in the plane
    x = foot[0] - s.offset_m * b_n * t_z - s.along_m * t_e - s.out_m - s.wrist_m * t_z
    z = foot[2] + s.offset_m * b_n * t_e - s.along_m * t_z - s.down_m + s.wrist_m * t_e
    distance2 = x * x + z * z
    distance = np.sqrt(distance2)
    longest, shortest = s.upper_m + s.fore_m, abs(s.upper_m - s.fore_m)
    missing = np.maximum(np.maximum(distance - longest, shortest - distance), 0.0)
    cosine = (distance2 - s.upper_m**2 - s.fore_m**2) / (2 * s.upper_m * s.fore_m)
    return Reach(x, z, np.arccos(np.clip(cosine, -1.0, 1.0)), missing)


def _circle_shortfall(s: OrthogonalArm, foot: InPlane, b: InPlane) -> Array:
    """By how much the wrist joint, on a circle around the foot, is out of reach whatever the turret axis."""
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
    """Output angles (5, ...); b_n and sine are the boresight's parts square to the plane and, in it, to t."""
    lean = np.arctan2(s.fore_m * np.sin(reach.bend_rad), s.upper_m + s.fore_m * np.cos(reach.bend_rad))
    q = np.empty((5, *lean.shape))
    q[0] = q1
    q[1] = np.arctan2(reach.z_m, reach.x_m) - lean
    q[2] = reach.bend_rad
    q[3] = np.arctan2(-t_e, t_z) - q[1] - q[2]
    q[4] = np.arctan2(-b_n, sine) - s.clock_rad
    q -= s.theta_rad.reshape(5, *(1,) * lean.ndim)
    return q
