"""Records of one cycle of the closed loop."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from fsw.dictionary.types import cycle_record
from fsw.messages import Outputs, Sensors


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The state of the plant at the start of a cycle; joint arrays in the order of Joint."""

    time_s: float
    """Of the plant, since it was built."""
    motor_rad: NDArray[np.float64]
    """Motor angle over gear ratio, zero at the true joint zero."""
    output_rad: NDArray[np.float64]
    """Motor angle + backlash + wind-up."""
    motor_torque_Nm: NDArray[np.float64]
    """Of the motors, at the output."""
    p_RoTo_R_m: NDArray[np.float64]
    """Every tool's origin, in the order of the tools, shape (n, 3), in the rover frame RMECH."""
    R_RT: NDArray[np.float64]
    """Every tool's axes as columns, shape (n, 3, 3)."""
    contact_force_N: float
    """Sum of the normal contact forces on the arm."""
    kinetic_energy_J: float
    """Kinetic energy."""


@cycle_record
class CycleRecord:
    """Inputs and outputs of one cycle; the tick is an integer at the cycle rate."""

    tick: int
    sensors: Sensors
    commands: tuple[Command, ...]
    outputs: Outputs
    truth: Truth | None
    """None if the truth was not requested: it costs time."""
