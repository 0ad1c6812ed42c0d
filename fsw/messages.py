"""Messages between flight software and avionics in each cycle."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.channels import JointChannels, ToolChannels
from fsw.dictionary.evrs import Evr
from fsw.dictionary.types import Limits, cycle_record

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


@cycle_record
class Sensors:
    """Readings of the avionics at the start of a cycle; arrays in the order of joints and switches."""

    cycle: int
    """Cycle counter of the avionics, with any start; it rises by one; a step of more means missed cycles."""
    encoder_count: Counts
    """Counts of the motor encoders, with any zero."""
    resolver_rad: Annotated[Floats, Limits(-6.5, 6.5)]
    """Output angles."""
    current_A: Annotated[Floats, Limits(-20.0, 20.0)]
    """Currents of the motors, positive for forward torque."""
    winding_C: Annotated[Floats, Limits(-130.0, 150.0)]
    """Temperatures of the motor windings."""
    structure_C: Annotated[float, Limits(-150.0, 100.0)]
    """Temperature of the structure of the arm."""
    switch_closed: Flags
    """True for contact switches that are closed."""
    gravity_R_m_s2: Annotated[Floats, Limits(-20.0, 20.0)]
    """Gravity (downward) in the rover frame RMECH, from the IMU of the rover."""


@cycle_record
class ActuatorCommand:
    """Commands to motor controllers and brakes; arrays in the order of Joint."""

    setpoint_count: Counts
    """Commanded motor positions, in counts of the encoders."""
    setpoint_rate_rad_s: Annotated[Floats, Limits(-0.1, 0.1)]
    """Commanded motor rates on the output side: motor rate over gear ratio."""
    current_limit_A: Annotated[Floats, Limits(0.0, 20.0)]
    """Largest current of each motor."""
    power_on: Flags
    """True for motor controllers with power."""
    brake_release: Flags
    """True for brakes to release."""
    vibrate: bool
    """True if the vibration motor of the turret runs."""


@cycle_record
class Outputs:
    """Outputs of a cycle: actuator command, channels and EVRs."""

    drive: ActuatorCommand
    """Commands to motor controllers and brakes."""
    joint: JointChannels
    """Channels of the joints."""
    tool: ToolChannels | None
    """Channels of the tool; None in cycles that do not refresh them."""
    evrs: tuple[Evr, ...]
    """Event reports of the cycle, in order."""
