"""Telemetry channels: a channel is a field, its packet the dataclass."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Mode, Tool
from fsw.dictionary.types import Limits


@dataclass(frozen=True, slots=True, eq=False)
class JointChannels:
    """Once a cycle: what the joints do and what is asked of them; output side, order of Joint."""

    tick: int
    """The cycle, counted from boot."""
    mode: Mode
    """What the arm is doing."""
    busy: bool
    """Whether a command is under way."""
    motor_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Encoder angle over gear ratio, zero applied: the output angle without backlash and wind-up.

    Of a joint that is not calibrated, what its resolver said at first and the motion since.
    """
    motor_rate_rad_s: Annotated[NDArray[np.float64], Limits(-0.1, 0.1)]
    """How fast the motor angle changes."""
    setpoint_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Motor angle that was asked for last, or where the brakes hold the motor."""
    output_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Believed, with backlash and wind-up."""
    gap_rad: Annotated[NDArray[np.float64], Limits(-0.01, 0.01)]
    """Believed output less motor angle inside the backlash, wind-up not counted."""
    gap_side: Annotated[NDArray[np.float64], Limits(-1.0, 1.0)]
    """+1 or -1 where the output surely lies on that flank, 0 floating: where nothing has decided it."""
    gap_uncertainty_rad: Annotated[NDArray[np.float64], Limits(0.0, 0.02)]
    """Half the range in which output less motor angle may be."""
    planned_gap_rad: Annotated[NDArray[np.float64], Limits(-0.01, 0.01)]
    """The gap that the last plan's set-points allow for."""
    calibrated: NDArray[np.bool_]
    """Which joints have found their hardstop."""
    resolver_error_rad: Annotated[NDArray[np.float64], Limits(-0.1, 0.1)]
    """Resolver less believed output and the bias learned at the hardstop, smoothed."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolChannels:
    """At a lower rate: where flight software believes the tool to be, gravity deflection included."""

    tick: int
    """The cycle, counted from boot."""
    tool: Tool
    """Which tool this is about: that of the last tool command."""
    p_RoTo_R_m: Annotated[NDArray[np.float64], Limits(-5.0, 5.0)]
    """The tool's origin in the rover frame RMECH."""
    R_RT: Annotated[NDArray[np.float64], Limits(-1.0, 1.0)]
    """Tool axes as columns, 3x3, in the rover frame RMECH."""
    output_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Joint angles at the output, backlash and wind-up included."""
    load_torque_Nm: Annotated[NDArray[np.float64], Limits(-1500.0, 1500.0)]
    """Torque that each joint is believed to carry, order of Joint."""
