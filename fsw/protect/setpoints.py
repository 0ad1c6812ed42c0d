"""Limits of protection's own on what goes out to the motors, whatever planned it."""

from typing import Final

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
    limits = lowest_rad.tolist(), config.highest_rad.tolist(), config.setpoint_step_rad.tolist()
    each = zip(setpoint_rad.tolist(), last_rad.tolist(), *limits, strict=True)
    for joint, (asked, last, lowest, highest, step) in enumerate(each):
        # written so that NaN fails it
        near = abs(asked - last) <= step
        low_safe = asked >= lowest or asked >= last - ROUNDING_RAD
        high_safe = asked <= highest or asked <= last + ROUNDING_RAD
        if not (near and low_safe and high_safe):
            return (SetpointUnsafe(Joint(joint), asked, last),)
    return ()
