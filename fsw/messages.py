"""What crosses the boundary of flight software in each cycle."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.channels import JointChannels, ToolChannels
from fsw.dictionary.evrs import Evr
from fsw.dictionary.types import Limits

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """What the avionics read at the start of a cycle; arrays in the order of Joint and Switch."""

    cycle: int
    """The avionics' own count of cycles, from any number on: a step of more than one is a cycle missed."""
    encoder_count: Counts
    """Of the motors, counted from anywhere."""
    resolver_rad: Annotated[Floats, Limits(-6.5, 6.5)]
    """Output angles."""
    current_A: Annotated[Floats, Limits(-20.0, 20.0)]
    """Of the motors, driving forward if positive."""
    winding_C: Annotated[Floats, Limits(-130.0, 150.0)]
    """Temperature of the motors' windings."""
    switch_closed: Flags
    """Which contact switches touch."""
    gravity_R_m_s2: Annotated[Floats, Limits(-20.0, 20.0)]
    """Gravity (downward pull) in the rover frame RMECH, from the rover's IMU."""


@dataclass(frozen=True, slots=True, eq=False)
class ActuatorCommand:
    """What flight software asks of the motor controllers and brakes; arrays in the order of Joint."""

    setpoint_count: Counts
    """Where the motors are to be, in counts of their encoders."""
    setpoint_rate_rad_s: Annotated[Floats, Limits(-0.1, 0.1)]
    """Output side, motor angle over gear ratio."""
    current_limit_A: Annotated[Floats, Limits(0.0, 20.0)]
    """Most that each motor may draw."""
    power_on: Flags
    """Which motor controllers have power."""
    brake_release: Flags
    """Which brakes are to let go."""
    vibrate: bool
    """Whether the turret's vibration motor runs."""


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    """What a cycle gives: the drive, the channels (tool channels only when refreshed) and the EVRs."""

    drive: ActuatorCommand
    joint: JointChannels
    tool: ToolChannels | None
    evrs: tuple[Evr, ...]
