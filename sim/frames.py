"""Frames of the rover and of MuJoCo's world, and the workspace of an arm.

RNAV has x forward, y right, z down, and its origin on the ground. RMECH is parallel to RNAV, at P_NR.
MuJoCo's world is RNAV rotated by half a turn about x, so that z is up.
Flight software works in RMECH, people in RNAV.
"""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from fsw.dictionary.types import Limits, Vector3
from fsw.kinematics.transforms import Array, gravity_direction

P_NR_M: Final = np.array([0.09002, 0.0, -1.1205])
"""Origin of RMECH in RNAV."""
FLIP: Final = np.array([1.0, -1.0, -1.0])
"""Componentwise factor from RNAV axes to world axes, and back."""


def p_R_from_N(p_N_m: Array) -> Array:
    """Convert points, shape (..., 3), from RNAV to RMECH [m]."""
    p_R_m: Array = p_N_m - P_NR_M
    return p_R_m


def gravity_in_rover(roll_rad: float, pitch_rad: float, gravity_m_s2: float) -> Array:
    """Compute gravity in RNAV axes, (3,), for a rover pitched nose up, then rolled right side down."""
    pull: Array = gravity_m_s2 * gravity_direction(roll_rad, pitch_rad)
    return pull


Metres = Annotated[float, Limits(-10.0, 10.0)]


@dataclass(frozen=True, slots=True)
class Workspace:
    """Upright cylinder, and wedge of approach vectors; z is down.

    The defaults are the primary workspace of the paper, section MSL Robotic Arm.
    """

    centre_x_m: Metres = 2.1
    centre_y_m: Metres = 0.0
    radius_m: Annotated[float, Limits(0.01, 5.0)] = 0.4
    top_z_m: Metres = -0.8
    bottom_z_m: Metres = 0.2
    wedge_down_rad: Annotated[float, Limits(0.0, np.pi / 2)] = np.pi / 2
    """Largest angle of the approach below horizontal; the least is 0."""
    wedge_side_rad: Annotated[float, Limits(0.0, np.pi)] = np.pi / 4
    """Largest angle of the approach to either side of straight ahead."""

    @property
    def hint(self) -> str:
        """Say where targets are."""
        middle_z_m = 0.5 * (self.top_z_m + self.bottom_z_m)
        return f"the workspace is around {self.centre_x_m:g} {self.centre_y_m:g} {middle_z_m:g} in RNAV"


PRIMARY: Final = Workspace()
"""Workspace of an arm whose file gives none."""


def random_surface(rng: np.random.Generator, workspace: Workspace = PRIMARY) -> tuple[Vector3, Vector3]:
    """Draw a point, uniform in the cylinder, and an outward normal, uniform over the two wedge angles."""
    point, angles = random_targets(rng, 1, workspace)
    x, y, z = (float(v) for v in point[:, 0])
    nx, ny, nz = (-float(v) for v in approach_from(angles)[:, 0])
    return (x, y, z), (nx, ny, nz)


def random_targets(
    rng: np.random.Generator, count: int, workspace: Workspace = PRIMARY
) -> tuple[Array, Array]:
    """Draw points (3, n) [m] in RNAV, uniform in the cylinder, and approach angles (2, n) over the wedge."""
    radius, heading, height, down, side = rng.random((count, 5)).T
    radius, heading = workspace.radius_m * np.sqrt(radius), _interpolate(heading, -np.pi, np.pi)
    height = _interpolate(height, workspace.top_z_m, workspace.bottom_z_m)
    x_m = workspace.centre_x_m + radius * np.cos(heading)
    point = np.array([x_m, workspace.centre_y_m + radius * np.sin(heading), height])
    side = _interpolate(side, -workspace.wedge_side_rad, workspace.wedge_side_rad)
    return point, np.array([_interpolate(down, 0.0, workspace.wedge_down_rad), side])


def approach_from(angles_rad: Array) -> Array:
    """Compute unit approach vectors in RNAV, (3, n), of angles below horizontal and to the right, (2, n)."""
    down, side = angles_rad
    return np.array([np.cos(down) * np.cos(side), np.cos(down) * np.sin(side), np.sin(down)])


def _interpolate(share: Array, low: float, high: float) -> Array:
    between: Array = low + (high - low) * share
    return between
