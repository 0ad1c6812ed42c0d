"""Primary workspace and its wedge of approach vectors (paper, section MSL Robotic Arm), in RNAV."""

from typing import Final

import numpy as np

from fsw.dictionary.types import Vector3
from fsw.kinematics.transforms import Array

CENTRE_X_M: Final = 2.1
RADIUS_M: Final = 0.4
TOP_Z_M: Final = -0.8
BOTTOM_Z_M: Final = 0.2
WEDGE_DOWN_RAD: Final = np.pi / 2
WEDGE_SIDE_RAD: Final = np.pi / 4


def random_surface(rng: np.random.Generator) -> tuple[Vector3, Vector3]:
    """Draw a point, uniform in the cylinder, and an outward normal, uniform over the two wedge angles."""
    point, angles = random_targets(rng, 1)
    x, y, z = (float(v) for v in point[:, 0])
    nx, ny, nz = (-float(v) for v in approach_from(angles)[:, 0])
    return (x, y, z), (nx, ny, nz)


def random_targets(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Draw points uniform in the cylinder, and approach angles uniform over the wedge.

    Returns:
        Points [m] in RNAV, shape (3, count).
        Angles [rad], shape (2, count): below horizontal, and to the right.
    """
    radius, heading, height, down, side = rng.random((count, 5)).T
    radius, heading = RADIUS_M * np.sqrt(radius), _interpolate(heading, -np.pi, np.pi)
    height = _interpolate(height, TOP_Z_M, BOTTOM_Z_M)
    point = np.array([CENTRE_X_M + radius * np.cos(heading), radius * np.sin(heading), height])
    return point, np.array(
        [_interpolate(down, 0.0, WEDGE_DOWN_RAD), _interpolate(side, -WEDGE_SIDE_RAD, WEDGE_SIDE_RAD)]
    )


def approach_from(angles_rad: Array) -> Array:
    """Compute unit approach vectors from angles below horizontal and to the right.

    Args:
        angles_rad: Angles, shape (2, n).

    Returns:
        Unit vectors in RNAV, shape (3, n).
    """
    down, side = angles_rad
    return np.array([np.cos(down) * np.cos(side), np.cos(down) * np.sin(side), np.sin(down)])


def _interpolate(share: Array, low: float, high: float) -> Array:
    between: Array = low + (high - low) * share
    return between
