"""Messages of each cycle: readings and actuator commands of the avionics, telemetry channels, events.

Each channel is a field, and its packet is the dataclass.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.types import Limits, NameMark, cycle_record


@cycle_record
class JointChannels:
    """State and commands of the joints in each cycle, on the output side, in the order of Joint."""

    tick: int
    """Number of the cycle since boot."""
    mode: Mode
    """Mode of the arm."""
    busy: bool
    """True while a command runs."""
    motor_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Encoder angle over gear ratio with the zero applied: the output angle without backlash and wind-up.

    For an uncalibrated joint, the first resolver reading plus the motion since.
    """
    motor_rate_rad_s: Annotated[NDArray[np.float64], Limits(-0.1, 0.1)]
    """Rate of the motor angle."""
    setpoint_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Last commanded motor angle, or the angle at which the brakes hold the motor."""
    output_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Estimated output angle, with backlash and wind-up."""
    backlash_rad: Annotated[NDArray[np.float64], Limits(-0.01, 0.01)]
    """Estimated position of the output inside its backlash, without wind-up."""
    backlash_side: Annotated[NDArray[np.float64], Limits(-1.0, 1.0)]
    """Side of the backlash: +1 or -1 if the output certainly lies on that flank, 0 if it is undecided."""
    backlash_uncertainty_rad: Annotated[NDArray[np.float64], Limits(0.0, 0.02)]
    """Largest error of the estimated output less motor angle."""
    planned_backlash_rad: Annotated[NDArray[np.float64], Limits(-0.01, 0.01)]
    """Position inside the backlash that the set-points of the last plan allow for."""
    calibrated: NDArray[np.bool_]
    """True for joints that have found their hardstop."""
    resolver_error_rad: Annotated[NDArray[np.float64], Limits(-0.1, 0.1)]
    """Resolver less estimated output and learned bias, smoothed."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolChannels:
    """Estimated pose of the tool with deflection and thermal growth, at a lower rate than the cycle."""

    tick: int
    """Number of the cycle since boot."""
    tool: Annotated[int, NameMark.TOOL]
    """Tool of the last tool command: its index among the tools of the parameters."""
    p_RoTo_R_m: Annotated[NDArray[np.float64], Limits(-5.0, 5.0)]
    """Origin of the tool in the rover frame RMECH."""
    R_RT: Annotated[NDArray[np.float64], Limits(-1.0, 1.0)]
    """Axes of the tool as columns, 3x3, in the rover frame RMECH."""
    output_rad: Annotated[NDArray[np.float64], Limits(-6.5, 6.5)]
    """Output angles, with backlash and wind-up."""
    structure_C: Annotated[float, Limits(-150.0, 100.0)]
    """Temperature of the structure that the pose allows for."""
    load_torque_Nm: Annotated[NDArray[np.float64], Limits(-1500.0, 1500.0)]
    """Estimated torque of the load on each joint, order of Joint."""


@cycle_record
class ReadingChannels:
    """Validity of the readings, when it changes and at the rate of the tool channels."""

    tick: int
    """Number of the cycle since boot."""
    encoder_valid: NDArray[np.bool_]
    """True for readings that were plausible and are used."""
    resolver_valid: NDArray[np.bool_]
    """True for readings that were plausible and are used."""
    current_valid: NDArray[np.bool_]
    """True for readings that were plausible and are used."""
    winding_valid: NDArray[np.bool_]
    """True for readings that were plausible and are used."""
    gravity_valid: bool
    """True if the reading was plausible and is used."""
    structure_valid: bool
    """True if the reading was plausible and is used."""
    encoder_unused_count: NDArray[np.int64]
    """Number of readings since boot that were not used."""
    resolver_unused_count: NDArray[np.int64]
    """Number of readings since boot that were not used."""
    current_unused_count: NDArray[np.int64]
    """Number of readings since boot that were not used."""
    winding_unused_count: NDArray[np.int64]
    """Number of readings since boot that were not used."""
    gravity_unused_count: int
    """Number of readings since boot that were not used."""
    structure_unused_count: int
    """Number of readings since boot that were not used."""


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
    readings: ReadingChannels | None = None
    """Channels of the readings; None in cycles that do not refresh them."""
