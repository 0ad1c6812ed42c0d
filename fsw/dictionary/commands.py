"""Commands: what the ground may ask. SI units; positions and directions in the rover frame RMECH."""

from dataclasses import dataclass
from typing import Literal

from fsw.dictionary.joints import Joint, Tool

Vector3 = tuple[float, float, float]
Joints5 = tuple[float, float, float, float, float]

Backlash = Literal["off", "on"]
"""Whether set-points allow for the gap, and moves end with every output on a known side of it."""
Deflection = Literal["off", "absolute", "relative"]
"""What is done about gravity: nothing, all of it, or only how it differs from where the arm is now."""


@dataclass(frozen=True, slots=True)
class Calibrate:
    """Run one joint to its negative hardstop and take its encoder zero from there; the others stay braked."""

    joint: Joint
    anew: bool = False
    """Take the hardstop where it is, even if it is not where it was found last."""


@dataclass(frozen=True, slots=True)
class CalibrateAll:
    """Calibrate every joint, in an order and by way of poses in which each may run to its hardstop."""

    anew: bool = False
    """Take the hardstops where they are, even if they are not where they were found last."""


@dataclass(frozen=True, slots=True)
class MoveJoint:
    """Move one calibrated joint to an output angle; the others stay on their brakes."""

    joint: Joint
    angle_rad: float
    backlash: Backlash = "on"


@dataclass(frozen=True, slots=True)
class Unstow:
    """Leave the stowed pose along the parameters' way points and end in the ready pose."""


@dataclass(frozen=True, slots=True)
class MoveJoints:
    """Move all joints to these output angles, synchronised and jerk-limited."""

    angle_rad: Joints5
    backlash: Backlash = "on"


@dataclass(frozen=True, slots=True)
class MoveTool:
    """Move in joint space until the tool is at a position with its x axis along an approach direction.

    With backlash compensation it may pass the position by some millimetres, in any direction, before it comes
    back to it: outputs that their load does not hold are dragged to their places.
    """

    tool: Tool
    p_RoTo_R_m: Vector3
    approach_R: Vector3
    line_m: float = 0.0
    """Straight travel along the approach that must remain possible from there."""
    backlash: Backlash = "on"
    deflection: Deflection = "absolute"
    branch: str = "AUTO"
    """AUTO, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class GuardedMove:
    """Move the tool in a straight line, slowly, until a contact switch closes; no contact is a fault."""

    tool: Tool
    end_p_RoTo_R_m: Vector3
    approach_R: Vector3
    backlash: Backlash = "on"
    deflection: Deflection = "absolute"


@dataclass(frozen=True, slots=True)
class Retract:
    """Move the tool in a straight line back along its approach axis."""

    tool: Tool
    distance_m: float
    backlash: Backlash = "on"
    deflection: Deflection = "absolute"


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop the motion under way, brakes on; not a fault."""


@dataclass(frozen=True, slots=True)
class ClearFault:
    """Accept commands again after a fault."""


Command = (
    Calibrate
    | CalibrateAll
    | Unstow
    | MoveJoint
    | MoveJoints
    | MoveTool
    | GuardedMove
    | Retract
    | Stop
    | ClearFault
)
