"""Frames of the rover and of MuJoCo's world.

RNAV has x forward, y right, z down, and its origin on the ground. RMECH is parallel to RNAV, at P_NR.
MuJoCo's world is RNAV rotated by half a turn about x, so that z is up.
Flight software works in RMECH, people in RNAV.
"""

from typing import Final

import numpy as np

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
    """Compute gravity in RNAV axes, shape (3,), for a rover that is pitched and then rolled.

    Args:
        roll_rad: Roll, positive with the right side down.
        pitch_rad: Pitch, positive with the nose up.
    """
    pull: Array = gravity_m_s2 * gravity_direction(roll_rad, pitch_rad)
    return pull
