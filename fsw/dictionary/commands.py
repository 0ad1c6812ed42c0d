"""Commands of the ground. SI units; positions and directions in the rover frame RMECH."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from fsw.dictionary.enums import Joint
from fsw.dictionary.types import (
    AUTO,
    Angle,
    BranchName,
    Direction,
    Distance,
    DistanceOrZero,
    FrameName,
    Joints5,
    Limits,
    Position,
    ToolName,
)

BacklashMode = Literal["off", "on"]
"""Backlash compensation: set-points allow for the backlash, and each output ends on a known side of it."""
DeflectionMode = Literal["off", "absolute", "relative"]
"""Gravity compensation: none, of the whole deflection, or of its change from the present pose."""
JointDeflectionMode = Literal["off", "absolute"]
"""Gravity compensation of a move to joint angles, which has no tool as reference."""
ROVER: Final = "rover"
"""Name of frame RMECH in a command."""

JointAngles = Annotated[Joints5, Limits(-7.0, 7.0)]
"""Output angles; a full turn and a tenth, as no joint turns farther."""
Attitude = Annotated[float, Limits(-1.6, 1.6)]
"""Angle of the rover's attitude; a quarter turn and a fiftieth, beyond which the rover lies on its roof."""
Force = Annotated[float, Limits(0.0, 1000.0)]
"""Force; the limit of `preload.max_force_N`, which is the bound of the arm."""
Duration = Annotated[float, Limits(0.0, 3600.0)]
"""Duration; an hour, the longest that a sequence may hold its turn."""
ParamValue = Annotated[float, Limits(-1e9, 1e9)]
"""Value of a parameter; ten times the largest limit of any, whose own limits apply."""


@dataclass(frozen=True, slots=True)
class Calibrate:
    """Run one joint to its negative hardstop and set its encoder zero there; the others stay braked."""

    joint: Joint
    accept_moved: bool = False
    """Accept a hardstop that is not at the angle of the last calibration."""


@dataclass(frozen=True, slots=True)
class CalibrateAll:
    """Calibrate every joint, in a fixed order and in poses in which each joint may reach its hardstop."""

    accept_moved: bool = False
    """Accept hardstops that are not at the angles of the last calibration."""


@dataclass(frozen=True, slots=True)
class MoveJoint:
    """Move one calibrated joint to an output angle; the others stay braked."""

    joint: Joint
    angle_rad: Angle
    """Output angle."""
    backlash: BacklashMode = "on"


@dataclass(frozen=True, slots=True)
class Unstow:
    """Leave the stowed pose through the way points of the parameters and end in the ready pose."""


@dataclass(frozen=True, slots=True)
class Stow:
    """Move to the ready pose, then through the same way points to the stowed pose."""


@dataclass(frozen=True, slots=True)
class MoveJoints:
    """Move all joints to output angles, synchronised and with limited jerk."""

    angle_rad: JointAngles
    """Output angles, order of Joint."""
    backlash: BacklashMode = "on"
    deflection: JointDeflectionMode = "absolute"
    """Compensation of the wind-up of the gears."""
    relative: bool = False
    """True if the angles count from the present output angles."""


@dataclass(frozen=True, slots=True)
class MoveTool:
    """Move the tool to a position with its x axis along an approach direction.

    With backlash compensation, the tool may first pass the position by some millimetres in any direction. The
    gears drag outputs that their load does not hold.
    """

    tool: ToolName
    p_FoTo_F_m: Position
    """Target position of the tool's origin."""
    approach_F: Direction
    """Target direction of the tool's x axis, of any length."""
    frame: FrameName = ROVER
    """Frame F of position and approach: rover, or an arm frame or a tool at its estimated pose."""
    straight: bool = False
    """True for a straight line with an even turn of the tool; false for an even motion of the joints."""
    line_m: DistanceOrZero = 0.0
    """Length of straight travel along the approach that must be possible from the target."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"
    branch: BranchName = AUTO
    """auto, or the name of a branch."""


@dataclass(frozen=True, slots=True)
class GuardedMove:
    """Move the tool slowly in a straight line until a contact switch closes; no contact is a fault."""

    tool: ToolName
    end_p_RoTo_R_m: Position
    """Position at which the tool stops at the latest."""
    approach_R: Direction
    """Direction of the tool's x axis, of any length."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"
    normal_R: Direction | None = None
    """Normal out of the surface, of any length; None for against the approach."""


@dataclass(frozen=True, slots=True)
class PlaceTool:
    """Move to a standoff in front of a target, then straight on until a contact switch closes.

    All parts of the turret stay above the surface. If a direct way is not clear, the way leads from farther
    away.
    """

    tool: ToolName
    p_RoTo_R_m: Position
    """Position of the target."""
    approach_R: Direction
    """Direction of the tool's x axis, of any length."""
    standoff_m: Distance = 0.10
    """Distance before the target at which the guarded move begins."""
    overtravel_m: Distance = 0.05
    """Distance beyond the target up to which contact may occur."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"
    branch: BranchName = AUTO
    """auto, or the name of a branch."""
    normal_R: Direction | None = None
    """Normal out of the surface, of any length; None for against the approach."""


@dataclass(frozen=True, slots=True)
class Preload:
    """Press the touching tool with a force, by overdrive through the modelled stiffness; 0 releases it."""

    tool: ToolName
    force_N: Force
    """Force along the tool axis."""


@dataclass(frozen=True, slots=True)
class ToolChange:
    """Put another tool on the touched spot: retreat, turn the turret, touch again.

    The tools retreat farther if another part of the turret would not stay above the surface.

    The spot is the estimated position of the touching tool. Only the difference of deflection, backlash and
    kinematics between the two poses matters. Absolute and relative compensation therefore agree.
    """

    tool: ToolName
    standoff_m: Distance = 0.10
    """Least distance by which the tools retreat."""
    overtravel_m: Distance = 0.03
    """Distance beyond the spot up to which contact may occur."""
    hover_m: DistanceOrZero = 0.0
    """Distance in front of the spot at which to stop; 0 to touch."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "relative"
    branch: BranchName = AUTO
    """auto, or the name of a branch."""


@dataclass(frozen=True, slots=True)
class MoveTeachPoint:
    """Move a tool to a point that was taught on this arm, or to a distance in front of it."""

    point: str
    """Name of the point in the parameters."""
    standoff_m: DistanceOrZero = 0.0
    """Distance in front of the point."""
    along_gravity: bool = False
    """True if the tool axis is along gravity instead of as taught; standoff_m is then against gravity."""
    straight: bool = False
    """True for a straight line with an even turn of the tool; false for an even motion of the joints."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class Dock:
    """Move straight on from in front of a taught point, through it, until the tool touches."""

    point: str
    """Name of the point in the parameters."""
    overtravel_m: Distance = 0.01
    """Distance beyond the point up to which contact may occur."""
    backlash: BacklashMode = "on"


@dataclass(frozen=True, slots=True)
class Process:
    """Turn wrist and turret until gravity with tilt is along a direction of a tool; hold and vibrate."""

    tool: ToolName
    gravity_T: Direction
    """Direction of gravity in the axes of the tool."""
    duration_s: Duration
    """Time to hold the direction."""
    vibrate: bool = True
    """True if the vibration motor of the turret runs meanwhile."""
    backlash: BacklashMode = "on"
    deflection: JointDeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class Retract:
    """Move the tool in a straight line back along its approach axis."""

    tool: ToolName
    distance_m: Distance
    """Distance."""
    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"


@dataclass(frozen=True, slots=True)
class SetTilt:
    """Use this attitude of the rover, instead of the direction of gravity from the IMU, until boot."""

    roll_rad: Attitude
    """Roll, right side down, applied after the pitch."""
    pitch_rad: Attitude
    """Pitch, nose up."""


@dataclass(frozen=True, slots=True)
class SetParam:
    """Set one number of the parameters, by its dotted name, until boot."""

    name: str
    """Name, such as monitors.tilt_rad."""
    value: ParamValue
    """Value in the unit of the parameter."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop the current motion and engage the brakes; not a fault."""


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
