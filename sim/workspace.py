"""The primary workspace and its wedge of approach vectors (paper, section MSL Robotic Arm); RNAV, metres."""

from typing import Final

import numpy as np

from fsw.dictionary.commands import Vector3

CENTRE_X_M: Final = 2.1
RADIUS_M: Final = 0.4
TOP_Z_M: Final = -0.8
BOTTOM_Z_M: Final = 0.2
WEDGE_SIDE_RAD: Final = np.pi / 4


def random_surface(rng: np.random.Generator) -> tuple[Vector3, Vector3]:
    """A point uniform in the cylinder and an outward normal uniform over the wedge's two angles.

    The approach, against the normal, goes from horizontal forward to vertical down, and to either side.
    """
    radius, heading = RADIUS_M * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    point = (
        CENTRE_X_M + radius * np.cos(heading),
        radius * np.sin(heading),
        rng.uniform(TOP_Z_M, BOTTOM_Z_M),
    )
    down, side = rng.uniform(0.0, np.pi / 2), rng.uniform(-WEDGE_SIDE_RAD, WEDGE_SIDE_RAD)
    approach = (np.cos(down) * np.cos(side), np.cos(down) * np.sin(side), np.sin(down))
    x, y, z = (float(v) for v in point)
    nx, ny, nz = (-float(v) for v in approach)
    return (x, y, z), (nx, ny, nz)
