"""Soft limits of the joints: choice of turn, excess, and sentences that describe it."""

import math

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import Array, wrap_angle


def wrap_into_limits(arm: Arm, q: Array, near_rad: Array | None = None) -> Array:
    """Add whole turns to angles so that they lie inside the soft limits.

    If no turn fits, the result is the turn nearest to the limits.

    Args:
        arm: Arm.
        q: Output angles in rad, shape (5, ...).
        near_rad: Angles to stay near if two turns fit, shape (5,); None for the middle of the limits.

    Returns:
        The angles in rad, shape (5, ...).
    """
    low, high = _limits(arm, q)
    middle = 0.5 * (low + high)
    central = middle + wrap_angle(q - middle)
    if near_rad is None:
        return central
    near = np.clip(near_rad.reshape(low.shape), low, high)
    best = near + wrap_angle(q - near)
    inside = (best >= low) & (best <= high)
    return np.where(inside, best, central)


def limit_excess(arm: Arm, q: Array) -> Array:
    """Compute the excess of joint angles over the soft limits.

    Args:
        arm: Arm.
        q: Output angles in rad, shape (5, ...).

    Returns:
        Excess in rad, negative inside the limits, shape (5, ...).
    """
    low, high = _limits(arm, q)
    return np.maximum(low - q, q - high)


def describe_outside(arm: Arm, joint: Joint, angle_rad: float) -> str:
    """Describe a joint outside its soft limits, with enough digits to show the excess."""
    low, high = arm.soft_min_rad[joint], arm.soft_max_rad[joint]
    places = max(1, 1 - math.floor(math.log10(np.degrees(max(low - angle_rad, angle_rad - high, 1e-12)))))
    angle = f"{np.degrees(angle_rad):.{min(places, 9)}f} deg"
    return f"joint {joint.name.lower()}: {angle} is outside {_describe_range(arm, joint, min(places, 9))}"


def format_digits(value: float, places: int) -> str:
    """Format a positive number with this many decimals, or more if it would read as 0."""
    return f"{value:.{max(places, -math.floor(math.log10(max(value, 1e-12))))}f}"


def describe_estimated_outside(arm: Arm, joint: Joint, beyond_rad: float) -> str:
    """Describe a joint outside its soft limits whose angle is only estimated."""
    limits = _describe_range(arm, joint, 1)
    return f"joint {joint.name.lower()}: about {np.degrees(beyond_rad):.1f} deg outside {limits}"


def _describe_range(arm: Arm, joint: Joint, places: int) -> str:
    """Describe the soft limits of a joint in degrees."""
    low_deg, high_deg = np.degrees(arm.soft_min_rad[joint]), np.degrees(arm.soft_max_rad[joint])
    return f"its soft limits {low_deg:.{places}f} .. {high_deg:.{places}f} deg"


def _limits(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return the lowest and highest angles, with as many axes as the angles."""
    ones = (1,) * (q.ndim - 1)
    return arm.soft_min_rad.reshape(5, *ones), arm.soft_max_rad.reshape(5, *ones)
