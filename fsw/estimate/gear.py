"""Where an output lies against its motor: backlash and wind-up together, known to within an interval.

The gear angle is output less motor angle. The gear's spring, with a dead band of the backlash, carries the
load less what the friction of the output takes, which is anything up to F either way:

    angle_under(load - F)  <=  gear angle  <=  angle_under(load + F)

Between these bounds friction holds the output where it is while the motor turns; at a bound the gear drags
it. So side of the gap, wind-up, hysteresis and history are one clip. It is monotone in the angle and in the
load: what is believed at the least, with the least load, and at the most, with the most, bound the truth for
good. Where both end on one flank the side is known; where they do not, nothing has decided it.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.kinematics.transforms import Array

LEAST, LIKELY, MOST = range(3)
ERROR_SIGNS: Final = np.array([-1.0, 0.0, 1.0])
MARS_GRAVITY_M_S2: Final = 3.711
ON_FLANK_RAD: Final = 1e-6
STILL_RAD: Final = 2e-5
"""An output that is to move less than this is left where it lies."""


@dataclass(frozen=True, slots=True, eq=False)
class GearBounds:
    """Between which gear angles friction can hold each output; (5, ...)."""

    lowest_rad: Array
    highest_rad: Array


def bound_gear(config: Config, half_gap_rad: Array, load_Nm: Array) -> GearBounds:
    """The bounds under loads (5, ...), which pull the output to positive angles if they are positive."""
    friction, half = _rows(config.output_friction_Nm, load_Nm), _rows(half_gap_rad, load_Nm)
    stiffness = _rows(config.arm.gear_stiffness_Nm_rad, load_Nm)
    least, most = load_Nm - friction, load_Nm + friction
    return GearBounds(
        lowest_rad=np.where(least > 0, half, -half) + least / stiffness,
        highest_rad=np.where(most < 0, -half, half) + most / stiffness,
    )


def bound_loads(config: Config, load_Nm: Array, gravity_R_m_s2: Array, more_Nm: Array | None = None) -> Array:
    """Modelled loads (5) at the least, likely and at the most, `more_Nm` (5) as uncertain on top; (5, 3)."""
    error = load_error(config, gravity_R_m_s2)
    if more_Nm is not None:
        error = error + more_Nm
    loads: Array = load_Nm[:, None] + error[:, None] * ERROR_SIGNS
    return loads


def load_error(config: Config, gravity_R_m_s2: Array) -> Array:
    """How far modelled loads (5) may be from the true ones: in proportion to gravity, as most of it is."""
    error: Array = config.load_error_Nm * (sqrt(float(gravity_R_m_s2 @ gravity_R_m_s2)) / MARS_GRAVITY_M_S2)
    return error


def gear_after_motor_turn(gear_rad: Array, motion_rad: Array, bounds: GearBounds) -> Array:
    """The gear angles (5, 3) after the motors turned by so much (5)."""
    turned = gear_rad - motion_rad[:, None]
    after: Array = np.minimum(np.maximum(turned, bounds.lowest_rad), bounds.highest_rad)
    return after


def gear_after_output_turn(gear_rad: Array, moved_rad: Array, bounds: GearBounds) -> Array:
    """The gear angles (5, ...) once the *outputs* have moved by so much: what a set-point must allow for."""
    dragged = np.where(moved_rad > 0, bounds.lowest_rad, bounds.highest_rad)
    held = np.clip(gear_rad, bounds.lowest_rad, bounds.highest_rad)
    moved: Array = np.where(np.abs(moved_rad) > STILL_RAD, dragged, held)
    return moved


def locate_in_backlash(half_gap_rad: Array, gear_rad: Array) -> Array:
    """How the outputs lie in their gaps, for gear angles (5, 3).

    Returns:
        (3, 5): the likely place in the gap, wind-up not counted; +1 or -1 where the output surely lies on
        that side, 0 where nothing has decided; how far the gear angle may be from its likely value.
    """
    gap, side, unsure = [], [], []
    for (least, likely, most), half in zip(gear_rad.tolist(), half_gap_rad.tolist(), strict=True):
        gap.append(min(max(likely, -half), half))
        flank = half - ON_FLANK_RAD
        side.append(1.0 if least >= flank else -1.0 if most <= -flank else 0.0)
        unsure.append(max(most - likely, likely - least))
    return np.array((gap, side, unsure))


def clip_to_backlash(half_gap_rad: Array, gear_rad: Array) -> Array:
    """The part of gear angles (5, ...) that is backlash: half the width on a flank."""
    half = _rows(half_gap_rad, gear_rad)
    gap: Array = np.minimum(np.maximum(gear_rad, -half), half)
    return gap


def _rows(per_joint: Array, like: Array) -> Array:
    """A value per joint (5) beside joint arrays (5, ...)."""
    return per_joint if like.ndim == 1 else per_joint.reshape(-1, *(1,) * (like.ndim - 1))
