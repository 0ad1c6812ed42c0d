"""Commands: what the ground may ask. SI units; positions and directions in the rover frame RMECH."""

from dataclasses import dataclass
from typing import Literal

from fsw.dictionary.joints import Tool

Vector3 = tuple[float, float, float]
Joints5 = tuple[float, float, float, float, float]
Sides5 = tuple[int, int, int, int, int]

Deflection = Literal["off", "absolute"]


@dataclass(frozen=True, slots=True)
class SetReference:
    """Take these as the motor angles (output side) of this moment, and these as the sides of the backlash."""

    motor_rad: Joints5
    gap_side: Sides5


@dataclass(frozen=True, slots=True)
class Unstow:
    """Leave the stowed pose along the parameters' way points and end in the ready pose."""


@dataclass(frozen=True, slots=True)
class MoveJoints:
    """Move all joints to these output angles, synchronised and jerk-limited."""

    angle_rad: Joints5


@dataclass(frozen=True, slots=True)
class MoveTool:
    """Move in joint space until the tool is at a position with its x axis along an approach direction."""

    tool: Tool
    p_RoTo_R_m: Vector3
    approach_R: Vector3
    line_m: float = 0.0
    """Straight travel along the approach that must remain possible from there."""
    deflection: Deflection = "absolute"
    branch: str = "AUTO"
    """AUTO, or one of the names in kinematics.closed_form.BRANCHES."""


@dataclass(frozen=True, slots=True)
class GuardedMove:
    """Move the tool in a straight line, slowly, until a contact switch closes; no contact is a fault."""

    tool: Tool
    end_p_RoTo_R_m: Vector3
    approach_R: Vector3
    deflection: Deflection = "absolute"


@dataclass(frozen=True, slots=True)
class Retract:
    """Move the tool in a straight line back along its approach axis."""

    tool: Tool
    distance_m: float
    deflection: Deflection = "absolute"


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop the motion under way, brakes on; not a fault."""


@dataclass(frozen=True, slots=True)
class ClearFault:
    """Accept commands again after a fault."""


Command = SetReference | Unstow | MoveJoints | MoveTool | GuardedMove | Retract | Stop | ClearFault
