"""Azimuths of the closed form: radial tools, and tools with an offset from the turret axis.

The azimuth q1 of a tool solves this equation:

    rho sin(q1 - heading) + offset sine = lateral,  sine^2 = 1 - bz^2 - a_n^2,  a_n = a_xy sin(q1 - bearing)

rho and heading are the polar coordinates of the foot: the point of the boresight nearest to the turret axis.
a_xy and bearing are those of the approach. bz is the cosine of boresight and turret axis. A negative sine
means wrist up. A radial tool has offset 0 and needs one step. For any other tool, the azimuths of both wrists
are the four roots of one trigonometric polynomial.

In all functions, `foot` is that point in m and `a` the approach, a unit vector, in frame Arm1, (3, ...). They
return azimuths in rad, constant turn included, sines of the wrist and missing distances in m: of both
shoulders and wrists, (shoulder, wrist, ...), or, from a near azimuth and the sign of the wrist sine, of one
root each, (n,).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import OrthogonalArm
from fsw.kinematics.transforms import Array

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
