"""Telemetry channels: a channel is a field, its packet the dataclass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.joints import Tool
from fsw.dictionary.modes import Mode


@dataclass(frozen=True, slots=True, eq=False)
class JointChannels:
    """Once a cycle: what the joints do and what is asked of them; output side, order of Joint."""

    tick: int
    """The cycle, counted from boot."""
    mode: Mode
    """What the arm is doing."""
    busy: bool
    """Whether a command is under way."""
    motor_rad: NDArray[np.float64]
    """Encoder angle over gear ratio, zero applied: the output angle without backlash and wind-up.

    Of a joint that is not calibrated, what its resolver said at first and the motion since.
    """
    motor_rate_rad_s: NDArray[np.float64]
    """How fast the motor angle changes."""
    setpoint_rad: NDArray[np.float64]
    """Motor angle that was asked for last, or where the brakes hold the motor."""
    output_rad: NDArray[np.float64]
    """Believed, with backlash and wind-up."""
    gap_rad: NDArray[np.float64]
    """Believed output less motor angle inside the backlash, wind-up not counted."""
    gap_side: NDArray[np.float64]
    """+1 or -1 where the output surely lies on that flank, 0 floating: where nothing has decided it."""
    gap_uncertainty_rad: NDArray[np.float64]
    """Half the range in which output less motor angle may be."""
    planned_gap_rad: NDArray[np.float64]
    """The gap that the last plan's set-points allow for."""
    calibrated: NDArray[np.bool_]
    """Which joints have found their hardstop."""
    resolver_error_rad: NDArray[np.float64]
    """Resolver less believed output and the bias learned at the hardstop, smoothed."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolChannels:
    """At a lower rate: where flight software believes the tool to be, gravity deflection included."""

    tick: int
    """The cycle, counted from boot."""
    tool: Tool
    """Which tool this is about: that of the last tool command."""
    p_RoTo_R_m: NDArray[np.float64]
    """The tool's origin in the rover frame RMECH."""
    R_RT: NDArray[np.float64]
    """Tool axes as columns, 3x3, in the rover frame RMECH."""
    output_rad: NDArray[np.float64]
    """Joint angles at the output, backlash and wind-up included."""
    load_torque_Nm: NDArray[np.float64]
    """Torque that each joint is believed to carry, order of Joint."""
