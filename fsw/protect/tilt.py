"""The monitor of the rover's attitude: a plan holds for the gravity that it was made for."""

from math import atan2, sin

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import TiltChanged
from fsw.kinematics.transforms import Array


def tilt(config: Config, last: int, planned_R: Array, read_R: Array) -> tuple[int, tuple[Evr, ...]]:
    """Gravity in another direction than when the move began; how many cycles it has been so, what was found.

    Both are in RMECH, and only their directions count.
    """
    bounds, near = config.params.monitors, sin(config.params.monitors.tilt_rad)
    ax, ay, az = planned_R.tolist()
    bx, by, bz = read_R.tolist()
    # vectors this close cannot differ more in direction
    if (bx - ax) ** 2 + (by - ay) ** 2 + (bz - az) ** 2 <= near * near * (ax * ax + ay * ay + az * az):
        return 0, ()
    turned = atan2(float(np.linalg.norm(np.cross(planned_R, read_R))), float(planned_R @ read_R))
    if turned <= bounds.tilt_rad:
        return 0, ()
    if last + 1 < bounds.tilt_persistence:
        return last + 1, ()
    return last + 1, (TiltChanged(turned, bounds.tilt_rad),)
