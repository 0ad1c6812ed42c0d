"""Limits of protection's own on what goes out to the motors, whatever planned it."""

from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import SetpointUnsafe
from fsw.dictionary.joints import Joint
from fsw.kinematics.transforms import Array

ROUNDING_RAD: Final = 1e-9


def unsafe_setpoint(
    config: Config, lowest_rad: Array, last_rad: Array, setpoint_rad: Array
) -> tuple[Evr, ...]:
    """A set-point that is not finite, leaves the limits, or jumps; () if it may go out.

    Outside the limits it may still move inward: that is the way back.
    """
    # written so that NaN fails it
    safe = np.abs(setpoint_rad - last_rad) <= config.setpoint_step_rad
    low_safe = setpoint_rad >= np.minimum(lowest_rad, last_rad - ROUNDING_RAD)
    high_safe = setpoint_rad <= np.maximum(config.highest_rad, last_rad + ROUNDING_RAD)
    if safe.all() and low_safe.all() and high_safe.all():
        return ()
    joint = Joint(int(np.argmin(safe & low_safe & high_safe)))
    return (SetpointUnsafe(joint, float(setpoint_rad[joint]), float(last_rad[joint])),)
