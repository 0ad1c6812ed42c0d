"""Gear angle of each joint, output less motor angle: backlash and wind-up together, estimated as an interval.

The spring of the gear has a dead band, the backlash. It carries the load less the friction of the output,
which is between -F and F:

    angle_under(load - F)  <=  gear angle  <=  angle_under(load + F)

Between these bounds, friction holds the output at rest while the motor turns. At a bound the gear drags the
output. Side of the backlash, wind-up, hysteresis and history are therefore one clip. It is monotone in the
angle and in the load. The lowest estimate with the lowest load and the highest with the highest load thus
bound the true angle. If both end on one flank the side is known; otherwise it is undecided.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import sqrt
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.kinematics.transforms import Array, Flags

LEAST, LIKELY, MOST = range(3)
"""Columns of interval estimates: lowest, likely and highest."""
ERROR_SIGNS: Final = np.array([-1.0, 0.0, 1.0])
"""Signs of the load error for the lowest, likely and highest estimate."""
MARS_GRAVITY_M_S2: Final = 3.711
ON_FLANK_RAD: Final = 1e-6
"""An output this close to a flank lies on it."""
STILL_RAD: Final = 2e-5
"""Smaller motions of an output are planned as no motion."""


@dataclass(frozen=True, slots=True, eq=False)
class GearBounds:
    """Bounds between which friction can hold each output, (5, ...)."""

    lowest_rad: Array
    """Lowest gear angles, (5, ...)."""
    highest_rad: Array
    """Highest gear angles, (5, ...)."""


def bound_gear(config: Config, half_backlash_rad: Array, load_Nm: Array) -> GearBounds:
    """Compute the bounds of the gear angles [rad] under loads, shape (5, ...) each."""
    friction, half = _rows(config.output_friction_Nm, load_Nm), _rows(half_backlash_rad, load_Nm)
    stiffness = _rows(config.arm.gear_stiffness_Nm_rad, load_Nm)
    least, most = load_Nm - friction, load_Nm + friction
    return GearBounds(
        lowest_rad=np.where(least > 0, half, -half) + least / stiffness,
        highest_rad=np.where(most < 0, -half, half) + most / stiffness,
    )


def include_gear(bounds: GearBounds, gear_rad: Array, where: Flags) -> GearBounds:
    """Widen the bounds of some joints to include gear angles (5, 3) that were measured.

    Args:
        where: Joints whose gear angle was measured, shape (5,).
    """
    lowest, highest = bounds.lowest_rad, bounds.highest_rad
    return GearBounds(
        lowest_rad=np.where(where[:, None], np.minimum(lowest, gear_rad), lowest),
        highest_rad=np.where(where[:, None], np.maximum(highest, gear_rad), highest),
    )


def bound_loads(config: Config, load_Nm: Array, gravity_R_m_s2: Array, more_Nm: Array | None = None) -> Array:
    """Compute the lowest, likely and highest loads [N m], shape (5, 3)."""
    error = load_error(config, gravity_R_m_s2)
    if more_Nm is not None:
        error = error + more_Nm
    loads: Array = load_Nm[:, None] + error[:, None] * ERROR_SIGNS
    return loads


def load_error(config: Config, gravity_R_m_s2: Array) -> Array:
    """Compute the error bound of modelled loads, (5,) [N m], in proportion to gravity, its main cause."""
    error: Array = config.load_error_Nm * (sqrt(float(gravity_R_m_s2 @ gravity_R_m_s2)) / MARS_GRAVITY_M_S2)
    return error


def gear_after_motor_turn(gear_rad: Array, motion_rad: Array, bounds: GearBounds) -> Array:
    """Compute the gear angles after a turn of the motors, shape (5, 3) [rad].

    Args:
        motion_rad: Turn of the motors on the output side, shape (5,).
        bounds: Bounds of the gear angles, shape (5, 3).
    """
    turned = gear_rad - motion_rad[:, None]
    after: Array = np.minimum(np.maximum(turned, bounds.lowest_rad), bounds.highest_rad)
    return after


def gear_after_output_turn(gear_rad: Array, moved_rad: Array, bounds: GearBounds) -> Array:
    """Compute the gear angles (5, ...) [rad] after a motion of the outputs, to compensate set-points.

    Args:
        moved_rad: Motion of the outputs, shape (5, ...).
        bounds: Bounds of the gear angles, shape (5, ...).
    """
    dragged = np.where(moved_rad > 0, bounds.lowest_rad, bounds.highest_rad)
    held = np.clip(gear_rad, bounds.lowest_rad, bounds.highest_rad)
    moved: Array = np.where(np.abs(moved_rad) > STILL_RAD, dragged, held)
    return moved


def locate_in_backlash(half_backlash_rad: Array, gear_rad: Array) -> Array:
    """Locate the outputs inside their backlash.

    Returns:
        Three rows, shape (3, 5): likely position inside the backlash in rad, without wind-up; side, +1 or -1
        if it is certain, else 0; largest error of the likely gear angle in rad.
    """
    return _locate_again(half_backlash_rad.tobytes(), gear_rad.tobytes())


@lru_cache(maxsize=1)
def _locate_again(half_backlash: bytes, gear: bytes) -> Array:
    """Locate the outputs, unless no gear angle has changed: at a bound it stays the same for many cycles."""
    half_rad, (least, likely, most) = np.frombuffer(half_backlash), np.frombuffer(gear).reshape(-1, 3).T
    flank_rad = half_rad - ON_FLANK_RAD
    located = np.empty((3, likely.size))
    np.minimum(np.maximum(likely, -half_rad), half_rad, out=located[0])
    np.subtract(least >= flank_rad, most <= -flank_rad, dtype=float, out=located[1])
    np.maximum(most - likely, likely - least, out=located[2])
    located.flags.writeable = False
    return located


def clip_to_backlash(half_backlash_rad: Array, gear_rad: Array) -> Array:
    """Compute the part (5, ...) [rad] of gear angles that is backlash: half its width on a flank."""
    half = _rows(half_backlash_rad, gear_rad)
    position: Array = np.minimum(np.maximum(gear_rad, -half), half)
    return position


def _rows(per_joint: Array, like: Array) -> Array:
    """Reshape a value per joint (5,) to broadcast with joint arrays (5, ...)."""
    return per_joint if like.ndim == 1 else per_joint.reshape(-1, *(1,) * (like.ndim - 1))
