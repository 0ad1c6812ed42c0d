"""What differs from one move to the next: where frames, gears and motors come to stand."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint, Tool
from fsw.kinematics.transforms import Array

BODIES: Final = (
    *("arm1", "link2", "link3", "link4", "link5", "turret"),
    *(tool.name.lower() for tool in Tool),
)
"""Of the plant, that stand for the frames Arm1 to Arm6 and for the tool frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """How far off the arm comes to stand after a move; scatters add up."""

    screw: Array
    """Of each of BODIES, in its own axes, (6, 11)."""
    gear_rad: Array
    """Outputs beyond backlash and wind-up, (5,)."""
    motor_rad: Array
    """Motors from where their encoders say, (5,), output side."""

    def __add__(self, other: "Scatter") -> "Scatter":
        return Scatter(
            self.screw + other.screw, self.gear_rad + other.gear_rad, self.motor_rad + other.motor_rad
        )


def no_scatter() -> Scatter:
    """Everything stands where it should."""
    return Scatter(np.zeros((6, len(BODIES))), np.zeros(len(Joint)), np.zeros(len(Joint)))


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
