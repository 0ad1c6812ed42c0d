"""Closed-form inverse kinematics of the orthogonal rigid arm for position and approach, by branch.

The plane of the arm holds the three parallel joints. The turret axis is normal to the pitch axis and makes a
fixed angle with the approach. This gives two directions: wrist down and up. The wrist centre has a known
lateral offset from the plane. This gives two azimuths: shoulder out and in. The rest is a planar two-link
arm, with two elbows.

The azimuth q1 of a tool solves this equation:

    rho sin(q1 - heading) + offset sine = lateral,  sine^2 = 1 - bz^2 - a_n^2,  a_n = a_xy sin(q1 - bearing)

rho and heading are the polar coordinates of the foot: the point of the boresight nearest to the turret axis.
a_xy and bearing are those of the approach. bz is the cosine of boresight and turret axis. A negative sine
means wrist up. A radial tool has offset 0 and needs one step. For any other tool, the azimuths of both wrists
are the four roots of one trigonometric polynomial.

In all functions, `q1` are azimuths in rad, constant turn included, `sine` the sines of the wrist, `t_e` and
`t_z` the forward and downward components of the turret axis, a unit vector; shape (...). Vectors in the rover
frame and in frame Arm1, as `foot` in m and the approach `a`, have shape (3, ...); in the plane of the arm
they are `InPlane`. Solvers of azimuths return them with sines and missing distances in m: of both shoulders
and wrists, (shoulder, wrist, ...), or, from a near azimuth and the sign of the wrist sine, of one root each,
(n,).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm, OrthogonalArm
from fsw.kinematics.transforms import Array, Integers, record_arrays, rotate_back

NEAR_CIRCLE: Final = 1e-3
"""Eigenvalues this close to the unit circle are treated as angles."""
POLISHING_STEPS: Final = 4
"""Newton steps on each azimuth."""
SMALL_SINE2: Final = 1e-6
"""Below it the root of sine^2 has lost its digits, and the lateral condition gives the sine."""
ROUNDING_M: Final = 1e-12
ROUNDING_M2: Final = 1e-14
"""Rounding error of a length, and of a difference of squared lengths."""
WRISTS: Final = np.array([-1.0, 1.0])
"""Signs of the wrist sine: up, down."""


def solve_azimuths(s: OrthogonalArm, foot: Array, a: Array) -> tuple[Array, Array, Array]:
    """Solve the azimuths of a radial tool."""
    lean, heading, missing = _lean(s, foot)
    q1 = np.stack([heading + lean, heading + np.pi - lean])[:, None]
    wrist = WRISTS.reshape(1, 2, *(1,) * heading.ndim)
    sine = wrist * np.sqrt(np.maximum(_sine2(s, a, q1), 0.0))
    return np.broadcast_to(q1, sine.shape), sine, np.broadcast_to(missing, sine.shape)


def solve_azimuth_near(
    s: OrthogonalArm, foot: Array, a: Array, wrist: Array, near_rad: Array
) -> tuple[Array, Array, Array]:
    """Solve the azimuth of a radial tool on a given side of the shoulder and the wrist."""
    lean, heading, missing = _lean(s, foot)
    ahead = foot[0] * np.cos(near_rad) + foot[1] * np.sin(near_rad) >= 0
    q1 = heading + np.where(ahead, lean, np.pi - lean)
    return q1, wrist * np.sqrt(np.maximum(_sine2(s, a, q1), 0.0)), missing


def _lean(s: OrthogonalArm, foot: Array) -> tuple[Array, Array, Array]:
    """Compute the angle between foot and arm plane, the heading of the foot, and the missing distance."""
    rho = np.hypot(foot[0], foot[1])
    lean = np.arcsin(np.minimum(np.maximum(s.lateral_m / np.maximum(rho, 1e-300), -1.0), 1.0))
    return lean, np.arctan2(foot[1], foot[0]), np.maximum(abs(s.lateral_m) - rho, 0.0)


def solve_offset_azimuths(s: OrthogonalArm, foot: Array, a: Array) -> tuple[Array, Array, Array]:
    """Solve the azimuths of a tool with an offset.

    The squared condition is a trigonometric polynomial of degree two. Its four roots, for both wrists, are
    eigenvalues of a companion matrix. Newton steps polish those on the unit circle.
    """
    z = np.linalg.eigvals(_companion(s, foot, a))
    q1: Array = np.moveaxis(np.angle(z), -1, 0).astype(np.float64)
    wrist = np.where(s.offset_m * (s.lateral_m - _lateral(foot, q1)) >= 0, 1.0, -1.0)
    is_angle = np.moveaxis(np.abs(np.abs(z) - 1.0) < NEAR_CIRCLE, -1, 0)
    for _ in range(POLISHING_STEPS):
        step = np.clip(_newton_step(s, foot, a, wrist, q1), -NEAR_CIRCLE, NEAR_CIRCLE)
        q1 = q1 - np.where(is_angle, step, 0.0)
    sine, missing = _offset_sine(s, foot, a, wrist, q1)
    # sort by wrist, then from shoulder out to shoulder in
    forward = foot[0] * np.cos(q1) + foot[1] * np.sin(q1)
    order = np.lexsort((-forward, wrist), axis=0)
    q1, sine, missing = (_in_pairs(np.take_along_axis(v, order, axis=0)) for v in (q1, sine, missing))
    return q1, sine, missing


def solve_offset_azimuth_near(
    s: OrthogonalArm, foot: Array, a: Array, wrist: Array, near_rad: Array
) -> tuple[Array, Array, Array]:
    """Solve the azimuth of a tool with an offset by Newton steps from a given azimuth."""
    q1 = near_rad
    for _ in range(POLISHING_STEPS):
        q1 = q1 - np.clip(_newton_step(s, foot, a, wrist, q1), -0.1, 0.1)
    return q1, *_offset_sine(s, foot, a, wrist, q1)


def _in_pairs(values: Array) -> Array:
    """Reshape values (4, ...), ordered by wrist and then by shoulder, to (shoulder, wrist, ...)."""
    return np.swapaxes(values.reshape(2, 2, *values.shape[1:]), 0, 1)


def _companion(s: OrthogonalArm, foot: Array, a: Array) -> NDArray[np.complex128]:
    """Build the companion matrices (..., 4, 4) with the eigenvalues exp(i q1)."""
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
    """Compute the lateral position of the foot, rho sin(q1 - heading), with the sign of the equation."""
    lateral: Array = foot[0] * np.sin(q1) - foot[1] * np.cos(q1)
    return lateral


def _sine2(s: OrthogonalArm, a: Array, q1: Array) -> Array:
    """Compute 1 - bz^2 - a_n^2, for a radial tool without cancellation near 0."""
    forward = a[0] * np.cos(q1) + a[1] * np.sin(q1)
    sine2: Array = forward * forward + a[2] * a[2] - s.boresight_z**2
    return sine2


def _offset_sine(s: OrthogonalArm, foot: Array, a: Array, wrist: Array, q1: Array) -> tuple[Array, Array]:
    """Compute the sine of the wrist and the error [m] of the lateral condition."""
    sine2, short = _sine2(s, a, q1), s.lateral_m - _lateral(foot, q1)
    sine = wrist * np.sqrt(np.maximum(sine2, 0.0))
    small = np.abs(sine2) < SMALL_SINE2
    squared = np.abs(short * short - s.offset_m**2 * sine2)
    missing = np.abs(s.offset_m * sine - short)
    missing = np.where(small, np.where(squared < ROUNDING_M2, 0.0, np.sqrt(squared)), missing)
    return np.where(small, short / s.offset_m, sine), np.where(missing < ROUNDING_M, 0.0, missing)


def _newton_step(s: OrthogonalArm, foot: Array, a: Array, wrist: Array, q1: Array) -> Array:
    """Compute the Newton step of the condition; for a small sine, that of its square, which is smooth."""
    c1, s1 = np.cos(q1), np.sin(q1)
    a_n, a_e = a[0] * s1 - a[1] * c1, a[0] * c1 + a[1] * s1
    forward = foot[0] * c1 + foot[1] * s1
    short, sine2 = s.lateral_m - _lateral(foot, q1), _sine2(s, a, q1)
    sine = wrist * np.sqrt(np.maximum(sine2, SMALL_SINE2))
    direct = _ratio(s.offset_m * sine - short, forward - s.offset_m * a_n * a_e / sine)
    d2 = s.offset_m**2
    squared = _ratio(short * short - d2 * sine2, 2 * (d2 * a_n * a_e - short * forward))
    return np.where(sine2 < SMALL_SINE2, squared, direct)


def _ratio(value: Array, slope: Array) -> Array:
    """Divide by a slope that is kept away from 0."""
    ratio: Array = value / np.where(np.abs(slope) < 1e-12, 1e-12, slope)
    return ratio


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
