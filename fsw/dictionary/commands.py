"""Commands: what the ground may ask. SI units; positions and directions in the rover frame RMECH."""

from dataclasses import dataclass
from typing import Final, Literal

from fsw.dictionary.enums import Joint, Tool
from fsw.dictionary.types import Joints5, Vector3

BacklashMode = Literal["off", "on"]
"""Whether set-points allow for the gap, and moves end with every output on a known side of it."""
DeflectionMode = Literal["off", "absolute", "relative"]
"""What is done about gravity: nothing, all of it, or only how it differs from where the arm is now."""
JointDeflectionMode = Literal["off", "absolute"]
"""The same of a move that goes to angles: there is no tool to count from."""
ROVER: Final = "ROVER"
"""The name of frame RMECH in a command."""


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
    """Of the output."""
    backlash: BacklashMode = "on"


@dataclass(frozen=True, slots=True)
class Unstow:
    """Leave the stowed pose along the parameters' way points and end in the ready pose."""


@dataclass(frozen=True, slots=True)
class Stow:
    """Go to the ready pose and from there along the same way points into the stowed pose."""


@dataclass(frozen=True, slots=True)
class MoveJoints:
    """Move all joints to these output angles, synchronised and jerk-limited."""

    angle_rad: Joints5
    """Of the outputs, order of Joint."""
    backlash: BacklashMode = "on"
    deflection: JointDeflectionMode = "absolute"
    """Whether wind-up of the gears is allowed for."""
    relative: bool = False
    """Whether the angles count from where the outputs are."""


@dataclass(frozen=True, slots=True)
class MoveTool:
    """Move the tool to a position with its x axis along an approach direction.

    With backlash compensation it may pass the position by some millimetres, in any direction, before it comes
    back to it: outputs that their load does not hold are dragged to their places.
    """

    tool: Tool
    p_FoTo_F_m: Vector3
    """Where the tool's origin is to be."""
    approach_F: Vector3
    """Direction that the tool's x axis is to have, of any length."""
    frame: str = ROVER
    """Frame F of position and approach: ROVER, or an arm frame or a tool as it is believed to stand."""
    straight: bool = False
    """Whether the tool moves in a straight line, turning evenly, or the joints move evenly."""
    line_m: float = 0.0
    """Straight travel along the approach that must remain possible from there."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"
    branch: str = "AUTO"
    """AUTO, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class GuardedMove:
    """Move the tool in a straight line, slowly, until a contact switch closes; no contact is a fault."""

    tool: Tool
    end_p_RoTo_R_m: Vector3
    """Where the tool stops at the latest."""
    approach_R: Vector3
    """Direction of the tool's x axis, of any length."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class PlaceTool:
    """Go to a standoff in front of a place, and from there straight on until a contact switch closes."""

    tool: Tool
    p_RoTo_R_m: Vector3
    """The place."""
    approach_R: Vector3
    """Direction of the tool's x axis, of any length."""
    standoff_m: float = 0.10
    """How far before the place the guarded move begins."""
    overtravel_m: float = 0.05
    """How far beyond the place contact may be looked for."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"
    branch: str = "AUTO"
    """AUTO, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class Preload:
    """Press the tool that touches by overdrive through the modelled stiffness; no force releases it."""

    tool: Tool
    force_N: float
    """Along the tool's axis."""


@dataclass(frozen=True, slots=True)
class ToolChange:
    """Put another tool on the spot that the arm touches: back off, turn the turret, touch again.

    The spot is where the touching tool is believed to be, so that only what differs between the two poses of
    deflection, backlash and kinematics enters: absolute compensation comes to the same as relative.
    """

    tool: Tool
    standoff_m: float = 0.10
    """How far the tools back off."""
    overtravel_m: float = 0.03
    """How far beyond the spot contact may be looked for."""
    hover_m: float = 0.0
    """Distance at which to stop in front of the spot; 0 is to touch."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "relative"
    branch: str = "AUTO"
    """AUTO, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class MoveTeachPoint:
    """Move a tool to a point that was taught on this arm, or to a distance in front of it."""

    point: str
    """Its name in the parameters."""
    away_m: float = 0.0
    """Distance in front of the point."""
    along_gravity: bool = False
    """Whether the tool looks along gravity, and stands off against it, whatever way it looked when taught."""
    straight: bool = False
    """Whether the tool moves in a straight line, turning evenly, or the joints move evenly."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class Dock:
    """From in front of a taught point straight on, through it, until the tool touches."""

    point: str
    """Its name in the parameters."""
    overtravel_m: float = 0.01
    """How far beyond the point contact may be looked for."""
    backlash: BacklashMode = "on"


@dataclass(frozen=True, slots=True)
class Process:
    """Turn wrist and turret until gravity, tilt included, lies along a direction of a tool; hold, vibrate."""

    tool: Tool
    gravity_T: Vector3
    """Direction, in the tool's axes."""
    duration_s: float
    """How long it is held."""
    vibrate: bool = True
    """Whether the turret's vibration motor runs meanwhile."""
    backlash: BacklashMode = "on"
    deflection: JointDeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class Retract:
    """Move the tool in a straight line back along its approach axis."""

    tool: Tool
    distance_m: float
    """How far."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class SetTilt:
    """Take this attitude of the rover in place of the direction of gravity that the IMU reads, until boot."""

    roll_rad: float
    """Right side down, after the pitch."""
    pitch_rad: float
    """Nose up."""


@dataclass(frozen=True, slots=True)
class SetParam:
    """Give one number of the parameters, by its dotted name, another value until boot."""

    name: str
    """Such as monitors.tilt_rad."""
    value: float
    """In the unit of the parameter."""


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
    | Stow
    | MoveJoint
    | MoveJoints
    | MoveTool
    | GuardedMove
    | PlaceTool
    | Preload
    | ToolChange
    | MoveTeachPoint
    | Dock
    | Process
    | Retract
    | SetTilt
    | SetParam
    | Stop
    | ClearFault
)
