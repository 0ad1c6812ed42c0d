"""The frames of the rover and of MuJoCo's world.

RNAV: x forward, y right, z down, origin on the ground. RMECH: parallel to RNAV, at P_NR. MuJoCo's world is
RNAV turned over about x, so that z is up. Flight software works in RMECH, people in RNAV.
"""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, gravity_direction

P_NR_M: Final = np.array([0.09002, 0.0, -1.1205])
"""Origin of RMECH in RNAV."""
FLIP: Final = np.array([1.0, -1.0, -1.0])
"""World axes from RNAV axes, componentwise; its own inverse."""


def p_R_from_N(p_N_m: Array) -> Array:
    """A point (..., 3) from RNAV to RMECH."""
    p_R_m: Array = p_N_m - P_NR_M
    return p_R_m


def gravity_in_rover(roll_rad: float, pitch_rad: float, gravity_m_s2: float) -> Array:
    """Gravity in RNAV axes of a rover rolled (right side down) after it is pitched (nose up)."""
    pull: Array = gravity_m_s2 * gravity_direction(roll_rad, pitch_rad)
    return pull
