"""Motor controllers of the plant: gains and integral limit of MuJoCo's dcmotor, whose bus voltage may sag."""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array

RESISTANCE, MOTOR_CONSTANT, GAINS = 0, 1, slice(4, 7)
"""Indices in MuJoCo's gain parameters of a dcmotor; GAINS are those of position, integral and rate."""
INTEGRAL_LIMIT: Final = 8
"""Index of `Imax` in its dynamic parameters."""
BUS_V: Final = 28.0
LEAST_GAIN_SHARE: Final = 1e-9
"""Gains of a servo without power, as a share: MuJoCo fails at 0, where a dcmotor would have no integral."""


@dataclass(frozen=True, slots=True, eq=False)
class Servos:
    """Motor controllers as they were built, in the order of Joint."""

    actuators: NDArray[np.intp]
    """Indices of their actuators, shape (5,)."""
    gains: Array
    """Gains of position, integral and rate, shape (5, 3)."""
    integral_limit_rads: Array
    """Limit of the integral of the error, shape (5,)."""
    full_voltage: Array
    """Current that the bus drives through the winding at rest, over the current limit, shape (5,)."""


def read_servos(model: mujoco.MjModel, actuators: NDArray[np.intp]) -> Servos:
    """Read the motor controllers of a model in which nothing is disturbed."""
    gain = model.actuator_gainprm[actuators]
    limit_A = model.actuator_forcerange[actuators, 1] / gain[:, MOTOR_CONSTANT]
    return Servos(
        actuators,
        gain[:, GAINS].copy(),
        model.actuator_dynprm[actuators, INTEGRAL_LIMIT],
        BUS_V / gain[:, RESISTANCE] / limit_A,
    )


def change_gains(model: mujoco.MjModel, servos: Servos, change: Array) -> None:
    """Change the gains in proportion to the bus voltage.

    A controller sets the duty cycle of its bridge. The limit of its integral is a current. So the limit of
    the integrated error rises as the gains fall, until the duty cycle is 1: then the bus sets the limit.

    Args:
        model: Model to change.
        servos: Its motor controllers as built.
        change: Change of their gains relative to the built ones, shape (5,).
    """
    share = np.maximum(1.0 + change, LEAST_GAIN_SHARE)
    model.actuator_gainprm[servos.actuators, GAINS] = servos.gains * share[:, None]
    rise = np.minimum(1.0 / share, servos.full_voltage)
    model.actuator_dynprm[servos.actuators, INTEGRAL_LIMIT] = servos.integral_limit_rads * rise
