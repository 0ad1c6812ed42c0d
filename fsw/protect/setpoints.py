"""Limits of protection's own on what goes out to the motors, whatever planned it."""

import numpy as np

from fsw.config import CYCLE_S, Config
from fsw.dictionary.evrs import Evr, SetpointUnsafe
from fsw.dictionary.joints import Joint
from fsw.kinematics.transforms import Array


def unsafe_setpoint(config: Config, last_rad: Array, setpoint_rad: Array) -> tuple[Evr, ...]:
    """A set-point that is not finite, leaves the soft limits, or jumps; () if it may go out.

    Outside the limits it may still move inward: that is the way back.
    """
    bounds = config.params.monitors
    step = setpoint_rad - last_rad
    beyond = np.maximum(setpoint_rad - config.arm.soft_max_rad, config.arm.soft_min_rad - setpoint_rad)
    before = np.maximum(last_rad - config.arm.soft_max_rad, config.arm.soft_min_rad - last_rad)
    outward = (beyond > bounds.soft_limit_margin_rad) & (beyond > before)
    # written so that NaN fails it
    safe = (np.abs(step) <= bounds.setpoint_step_factor * CYCLE_S * config.speed_rad_s) & ~outward
    if safe.all():
        return ()
    joint = Joint(int(np.argmin(safe)))
    return (SetpointUnsafe(joint, float(setpoint_rad[joint]), float(last_rad[joint])),)
