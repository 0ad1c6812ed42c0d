"""Disturbances of the plant: those of each control cycle, and those that are drawn for each move."""

from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint, Tool
from fsw.kinematics.transforms import Array

FRAME_BODIES: Final = (
    *("arm1", "link2", "link3", "link4", "link5", "turret"),
    *(tool.name.lower() for tool in Tool),
)
"""Of the plant, that stand for the frames Arm1 to Arm6 and for the tool frames."""


@dataclass(frozen=True, slots=True, eq=False)
class MoveDisturbance:
    """How far off the arm comes to stand after a move; scatters add up."""

    screw: Array
    """Of each of BODIES, in its own axes, (6, 11)."""
    gear_rad: Array
    """Outputs beyond backlash and wind-up, (5,)."""
    motor_rad: Array
    """Motors from where their encoders say, (5,), output side."""

    def __add__(self, other: "MoveDisturbance") -> "MoveDisturbance":
        return MoveDisturbance(
            self.screw + other.screw, self.gear_rad + other.gear_rad, self.motor_rad + other.motor_rad
        )


def no_move_disturbance() -> MoveDisturbance:
    """Everything stands where it should."""
    return MoveDisturbance(np.zeros((6, len(FRAME_BODIES))), np.zeros(len(Joint)), np.zeros(len(Joint)))


def body_index(frame: Frame, tool: Tool | None) -> int:
    """Which of BODIES stands for a frame.

    Raises:
        ValueError: the frame TOOL without a tool.
    """
    if frame is not Frame.TOOL:
        return int(frame)
    if tool is None:
        raise ValueError("an effect at TOOL names its tool")
    return int(Frame.TOOL) + tool


def _no_change() -> Array:
    return np.zeros(len(Joint))


@dataclass(frozen=True, slots=True, eq=False)
class Disturbance:
    """By how much each joint differs in this cycle from how it was built, (5,); influences add up."""

    friction_Nm: Array = field(default_factory=_no_change)
    """Coulomb friction of motor and gear, output side; together with what was built it is not negative."""
    damping_Nms_rad: Array = field(default_factory=_no_change)
    """Viscous friction of motor and gear, likewise."""
    gear_rad: Array = field(default_factory=_no_change)
    """Outputs beyond backlash and wind-up."""
    output_Nm: Array = field(default_factory=_no_change)
    """Torque on the outputs."""
    servo: Array = field(default_factory=_no_change)
    """Gains of the motor controllers, as a share of what they are."""

    def __add__(self, other: "Disturbance") -> "Disturbance":
        return Disturbance(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


NO_DISTURBANCE: Final = Disturbance()


def at_joint(joint: Joint, value: float) -> Array:
    """The value at one joint, 0 at the others."""
    values = np.zeros(len(Joint))
    values[joint] = value
    return values
