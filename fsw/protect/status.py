"""Plain values that protection is given about the arm, the move under way and the tool that presses.

The records are named tuples: they are made in every cycle, and a frozen dataclass takes five times as long.
"""

from typing import NamedTuple

from fsw.dictionary.enums import Joint, Mode
from fsw.kinematics.transforms import Array, Flags


class PressStatus(NamedTuple):
    """Record of a press under way."""

    tool: str
    force_N: float
    """Believed force of the tool on what it presses."""
    torque_per_N: Array
    """Change of the load on each joint per newton of force, (5,)."""
    resolver_error_at_touch_rad: Array
    """Resolver less estimated output when the tool touched, (5,)."""


class MoveStatus(NamedTuple):
    """Record of the move under way."""

    setpoint_rad: Array
    """Motor angles of this cycle, (5,)."""
    setpoint_rate_rad_s: Array
    is_stopping: bool
    """A command or a fault has stopped the move."""
    is_releasing: bool
    """The brakes are still letting go."""
    homing: Joint | None
    """Joint in homing; None if no joint is being homed."""
    approaching: str | None
    """Guarded tool that runs along its line and has not touched yet."""
    press: PressStatus | None
    """None unless a tool presses and the move is not being stopped."""


class ArmStatus(NamedTuple):
    """Record of mode, tool, estimate of the joints and move; joint arrays (5,), output side."""

    mode: Mode
    tool: str
    """Tool of the last tool command."""
    calibrated: Flags
    """Joints whose hardstop has been found."""
    motor_rad: Array
    motor_rate_rad_s: Array
    gear_rad: Array
    """Likely output less motor angle, backlash and wind-up together."""
    gear_lowest_rad: Array
    """Between this and the next friction can hold the gear angle under the likely load."""
    gear_highest_rad: Array
    gear_uncertainty_rad: Array
    """Greatest error of the likely gear angle."""
    side: Array
    """Side of the backlash, +1 or -1 if it is certain, else 0."""
    half_backlash_rad: Array
    resolver_error_rad: Array
    """Resolver less estimated output and learned bias, smoothed."""
    resolver_bias_rad: Array
    gravity_R_m_s2: Array
    """Gravity that moves are planned for, in the rover frame, (3,)."""
    imu_R_m_s2: Array
    """Gravity as the IMU reads it, smoothed, in the rover frame, (3,)."""
    move: MoveStatus | None
    """None while the arm stands on its brakes."""
