"""Records of plant and closed loop: truth, one cycle, and disturbances of a cycle or of a move."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import cycle_record
from fsw.kinematics.transforms import Array
from fsw.messages import Outputs, Sensors

LINK_BODIES: Final = ("arm1", "link2", "link3", "link4", "link5", "turret")
"""Bodies of the plant that represent the frames Arm1 to Arm6."""
NO_SCREW: Final = np.zeros(6)


@dataclass(frozen=True, slots=True, eq=False)
class MoveDisturbance:
    """Displacements of frames, gears and motors from a move on; they add up."""

    screws: Mapping[str, Array]
    """Displacement of each displaced frame body in its own axes, rotation first [rad, m], shape (6,)."""
    gear_rad: Array
    """Output angles beyond backlash and wind-up, shape (5,)."""
    motor_rad: Array
    """Motor angles beyond those that the encoders read, output side, shape (5,)."""

    def __add__(self, other: "MoveDisturbance") -> "MoveDisturbance":
        screws = {name: self.screw(name) + other.screw(name) for name in {**self.screws, **other.screws}}
        return MoveDisturbance(screws, self.gear_rad + other.gear_rad, self.motor_rad + other.motor_rad)

    def screw(self, body: str) -> Array:
        """Return the displacement of a frame body, shape (6,); 0 if it is not displaced."""
        return self.screws.get(body, NO_SCREW)


def no_move_disturbance() -> MoveDisturbance:
    """Return a disturbance without displacement."""
    return MoveDisturbance({}, np.zeros(len(Joint)), np.zeros(len(Joint)))


def frame_body(frame: Frame, tool: str | None) -> str:
    """Return the body of the plant that represents a frame; ValueError for TOOL without a tool."""
    if frame is not Frame.TOOL:
        return LINK_BODIES[frame]
    if tool is None:
        raise ValueError("an effect at TOOL names its tool")
    return tool


NO_CHANGE: Final = np.zeros(len(Joint))
NO_CHANGE.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class Disturbance:
    """Changes of each joint in one cycle against its built state, each of shape (5,); they add up.

    An array that is NO_CHANGE itself is neither added nor set.
    """

    friction_Nm: Array = field(default_factory=lambda: NO_CHANGE)
    """Coulomb friction of motor and gear, output side; the sum with the built one is at least 0."""
    damping_Nms_rad: Array = field(default_factory=lambda: NO_CHANGE)
    """Viscous friction of motor and gear, likewise."""
    gear_rad: Array = field(default_factory=lambda: NO_CHANGE)
    """Output angles beyond backlash and wind-up."""
    output_Nm: Array = field(default_factory=lambda: NO_CHANGE)
    """Torque on the outputs."""
    servo: Array = field(default_factory=lambda: NO_CHANGE)
    """Change of the gains of the motor controllers, relative to the built ones."""

    def __add__(self, other: "Disturbance") -> "Disturbance":
        return Disturbance(
            _add(self.friction_Nm, other.friction_Nm),
            _add(self.damping_Nms_rad, other.damping_Nms_rad),
            _add(self.gear_rad, other.gear_rad),
            _add(self.output_Nm, other.output_Nm),
            _add(self.servo, other.servo),
        )


def _add(one: Array, other: Array) -> Array:
    if other is NO_CHANGE:
        return one
    return other if one is NO_CHANGE else one + other


NO_DISTURBANCE: Final = Disturbance()


def at_joint(joint: Joint, value: float) -> Array:
    """Return an array, shape (5,), with this value at one joint and 0 at the others."""
    values = np.zeros(len(Joint))
    values[joint] = value
    return values


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
