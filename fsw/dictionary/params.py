"""Parameters of flight software: everything that it assumes about the arm and its motion.

Plain records of numbers load strictly, have one digest and read well. The names give SI units. Annotations
give the limits; the loader and the ground dictionary read them.
"""

import hashlib
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated

from fsw.dictionary.motion_params import (
    HardstopParams,
    HeatParams,
    MonitorParams,
    MotionParams,
    PreloadParams,
)
from fsw.dictionary.types import Angle, Joints5, Length, Limits, Matrix6, Row6, Vector3

_ZERO_ROW: Row6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RIGID: Matrix6 = (_ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW)
"""Compliance of a rigid link."""


@dataclass(frozen=True, slots=True)
class Transform6:
    """General link transform D = Rz(theta) Tz(d) Ry(beta) Ty(b) Rx(alpha) Tx(a), equation 1 of the paper."""

    theta_rad: Angle = 0.0
    """Turn about z, to which the angle of the link's joint is added."""
    d_m: Length = 0.0
    """Translation along z, after theta."""
    beta_rad: Angle = 0.0
    """Turn about y, after d."""
    b_m: Length = 0.0
    """Translation along y, after beta."""
    alpha_rad: Angle = 0.0
    """Turn about x, after b."""
    a_m: Length = 0.0
    """Translation along x, after alpha."""


@dataclass(frozen=True, slots=True)
class PointMass:
    """Point mass in the link frame, which turns with the joint of the link."""

    mass_kg: Annotated[float, Limits(0.0, 200.0)] = 0.0
    """Mass."""
    com_m: Vector3 = (0.0, 0.0, 0.0)
    """Position."""


@dataclass(frozen=True, slots=True)
class LinkParams:
    """Link: the transform to the frame at its end, its spring, and its mass on either side of the spring.

    The spring is at the elastic centre, in the link frame. The link frame is the frame at the start of the
    link, turned by its joint. The compliance maps (moment, force) to (rotation, translation).
    """

    transform: Transform6
    elastic_centre_m: Vector3 = (0.0, 0.0, 0.0)
    """Position of the spring in the link frame."""
    compliance: Matrix6 = RIGID
    """Compliance of the spring, moment first, with mixed units: rad/(N m), rad/N, m/(N m), m/N."""
    near: PointMass = PointMass()
    far: PointMass = PointMass()
    expansion_1_K: Row6 = _ZERO_ROW
    """Expansion per kelvin at the end of the link, in its end frame: rotation [rad/K], translation [m/K]."""


@dataclass(frozen=True, slots=True)
class Links:
    """Links, named by the frame at their end; arm1 is the rover up to the azimuth joint, without a joint."""

    arm1: LinkParams
    arm2: LinkParams
    arm3: LinkParams
    arm4: LinkParams
    arm5: LinkParams
    arm6: LinkParams

    def in_order(self) -> tuple[LinkParams, ...]:
        """Return the links from the rover outward."""
        return (self.arm1, self.arm2, self.arm3, self.arm4, self.arm5, self.arm6)


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within a radius of a segment."""

    from_m: Vector3
    """One end of the segment."""
    to_m: Vector3
    """Other end of the segment."""
    radius_m: Annotated[float, Limits(0.001, 1.0)]
    """Radius about the segment."""


@dataclass(frozen=True, slots=True)
class Box:
    """Box along the axes of its frame, turned about z."""

    centre_m: Vector3
    """Centre."""
    half_m: Vector3
    """Half the lengths of the edges x, y, z."""
    turn_rad: Angle = 0.0
    """Turn about z."""


@dataclass(frozen=True, slots=True)
class PartGeometry:
    """Shapes that enclose a part."""

    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True)
class ArmGeometry:
    """Parts of the arm but its tools: links in the frames before their springs, turret in Arm6.

    The housing of azimuth and elevation is not included: it turns between the plates of its bracket.
    """

    link2: PartGeometry
    link3: PartGeometry
    link4: PartGeometry
    link5: PartGeometry
    turret: PartGeometry


@dataclass(frozen=True, slots=True)
class RoverPart:
    """Part of the rover, with shapes in RMECH."""

    name: str
    """Name in sentences, with _ for a space."""
    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True)
class CollisionParams:
    """Obstacles of the arm, and the distance to keep from them."""

    padding_m: Annotated[float, Limits(0.0, 0.2)]
    """Distance that parts keep from each other."""
    ground_z_m: Annotated[float, Limits(0.0, 5.0)]
    """Position of level ground along the z axis of RMECH, which points down."""
    arm: ArmGeometry
    rover: tuple[RoverPart, ...]


@dataclass(frozen=True, slots=True)
class ToolParams:
    """Tool on the turret: its frame in the turret frame Arm6, and its shapes.

    The x axis of the tool is the approach direction.
    """

    name: str
    """Name in commands, in small letters."""
    title: str
    """Name in sentences."""
    transform: Transform6
    geometry: PartGeometry
    """Shapes for the collision check, in the tool frame."""
    expansion_1_K: Row6 = _ZERO_ROW
    """Expansion per kelvin, in tool axes."""


@dataclass(frozen=True, slots=True)
class SwitchParams:
    """Contact switch, with a bit in the sensor word."""

    name: str
    """Name in events, in small letters."""
    tool: str
    """Name of the tool that it is on."""


@dataclass(frozen=True, slots=True)
class JointParams:
    """Joint and its actuator; angles, speeds and torques are those of the output."""

    gear_ratio: Annotated[float, Limits(1.0, 1e5)]
    """Turns of the motor for one turn of the output."""
    encoder_counts_per_turn: Annotated[int, Limits(1, 65536)]
    """Encoder counts per turn of the motor."""
    backlash_rad: Annotated[float, Limits(0.0, 0.02)]
    """Nominal full width of the backlash."""
    gear_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    """Stiffness of the gear between motor and output."""
    output_friction_Nm: Annotated[float, Limits(0.0, 200.0)]
    """Static friction of the output."""
    damping_Nms_rad: Annotated[float, Limits(0.0, 1e5)]
    """Viscous friction of motor and gear at the lowest temperature of a move."""
    load_error_Nm: Annotated[float, Limits(0.0, 100.0)]
    """Largest error of the modelled load, less the friction of the output, on Mars."""
    torque_constant_Nm_A: Annotated[float, Limits(1.0, 1e4)]
    """Torque constant of the motor, at the output."""
    hardstop_rad: Angle
    """Output angle at the negative hardstop."""
    upper_hardstop_rad: Angle
    """Output angle at the positive hardstop, on which no joint is homed."""
    hardstop_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    """Stiffness of the hardstop, without the gear."""
    hardstop_press_Nm: Annotated[float, Limits(1.0, 2000.0)]
    """Torque, above the running torque, at which a joint on its hardstop stalls."""
    hardstop_rated_Nm: Annotated[float, Limits(1.0, 5000.0)]
    """Rated torque of the hardstop."""
    soft_min_rad: Angle
    """Lowest output angle of a move."""
    soft_max_rad: Angle
    """Highest output angle of a move."""
    speed_rad_s: Annotated[float, Limits(1e-3, 0.1)]
    """Highest speed of a move."""
    acceleration_rad_s2: Annotated[float, Limits(1e-3, 1.0)]
    """Highest acceleration of a move."""
    jerk_rad_s3: Annotated[float, Limits(1e-3, 10.0)]
    """Highest jerk of a move."""
    current_limit_A: Annotated[float, Limits(0.1, 20.0)]
    """Current limit of the motor in a move."""


@dataclass(frozen=True, slots=True)
class Joints:
    """The joints from the rover outward."""

    azimuth: JointParams
    elevation: JointParams
    elbow: JointParams
    wrist: JointParams
    turret: JointParams

    def in_order(self) -> tuple[JointParams, ...]:
        """Return the joints in the order of Joint."""
        return (self.azimuth, self.elevation, self.elbow, self.wrist, self.turret)


@dataclass(frozen=True, slots=True)
class PoseParams:
    """Named poses of the arm and the way between them."""

    stowed_rad: Joints5
    """Output angles of the stowed arm."""
    unstow_via_rad: tuple[Joints5, ...]
    """Output angles of the way points from the stowed to the ready pose, in order."""
    ready_rad: Joints5
    """Output angles of the pose in which work begins and ends."""


@dataclass(frozen=True, slots=True)
class TeachPoint:
    """Taught point: the pose of a tool in RMECH that flight software estimated at the correct pose."""

    name: str
    """Name of the point in commands."""
    tool: str
    """Name of the taught tool."""
    p_RoTo_R_m: Vector3
    """Estimated position of the tool."""
    approach_R: Vector3
    """Estimated direction of the tool's x axis."""
    branch: str = "auto"
    """Branch of the inverse kinematics: auto, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class ModelParams:
    """Drawing that the parameters belong to."""

    name: str
    """Name of the drawing."""
    sha256: str
    """SHA-256 of its description."""


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of flight software."""

    arm_name: str
    """Name of the arm."""
    model: ModelParams
    links: Links
    tools: tuple[ToolParams, ...]
    """Tools on the turret, in the order of every array of tools."""
    switches: tuple[SwitchParams, ...]
    """Contact switches, in the order of the sensor word."""
    joints: Joints
    hardstop: HardstopParams
    poses: PoseParams
    motion: MotionParams
    heat: HeatParams
    preload: PreloadParams
    collision: CollisionParams
    monitors: MonitorParams
    teach: tuple[TeachPoint, ...]

    @property
    def tool_names(self) -> tuple[str, ...]:
        """Return the names of the tools, in order."""
        return tuple(tool.name for tool in self.tools)

    @property
    def tool_switches(self) -> dict[str, tuple[int, ...]]:
        """Return the indices of the contact switches of each tool."""
        return {
            tool.name: tuple(k for k, switch in enumerate(self.switches) if switch.tool == tool.name)
            for tool in self.tools
        }

    @property
    def holding_force_N(self) -> dict[str, float]:
        """Return the believed force that keeps each tool in contact.

        A force that is shared evenly closes the switches of a tool last: at that of one switch times their
        number. One step of a press more is for what so small a force loses on its way to the surface. It is
        never more than a guarded tool may press with while its switches are open.
        """
        switch_N, step_N, most_N = (
            self.motion.switch_force_N,
            self.preload.step_N,
            self.monitors.guarded_force_N,
        )
        return {
            tool: min(len(switches) * switch_N + step_N, most_N)
            for tool, switches in self.tool_switches.items()
        }


def digest(params: Params) -> str:
    """Compute the SHA-256 of the parameter values; equal values give equal digests."""
    return hashlib.sha256(_canonical_text(params).encode()).hexdigest()


def _canonical_text(value: object) -> str:
    """Convert a value to the one text that all equal values share."""
    if is_dataclass(value):
        return "".join(
            [f"{name}={_canonical_text(getattr(value, name))};" for name in _field_names(value.__class__)]
        )
    if isinstance(value, tuple):
        return f"({','.join(_canonical_text(item) for item in value)})"
    return float(value).hex() if isinstance(value, float) else str(value)


@cache
def _field_names(record: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(record))
