"""Description of an arm: the content of its `arm.toml`, checked strictly, and the rover that carries it.

The arrangement is fixed: azimuth, elevation, elbow, wrist, turret. Everything else is in the file.
"""

import json
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import TeachPoint, Transform6
from fsw.dictionary.types import Angle, Joints5, Limits, Vector3, vector3
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array
from sim.frames import P_NR_M, Workspace
from simgap.common.errors import RobotError
from simgap.common.toml import describe_faults, parse_toml, read_toml

Expansion = Annotated[float, Limits(-1e-4, 1e-4)]
Gain = Annotated[float, Limits(0.0, 1e9)]
Share = Annotated[float, Limits(1e-6, 0.5)]
SmallAngle = Annotated[float, Limits(1e-9, 0.05)]
SmallLength = Annotated[float, Limits(1e-9, 0.05)]
Pair = tuple[float, float]
Six = tuple[float, float, float, float, float, float]
NO_SPRING: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class BadArm(ValueError):
    """Description of an arm that is refused; the message names every wrong field."""


@dataclass(frozen=True, slots=True)
class Actuator:
    """Motor with gear and servo; torques, angles and gains are those of the output.

    Numbers without limits here are flight parameters, which have them.
    """

    gear_ratio: float
    encoder_counts_per_turn: int
    torque_constant_Nm_A: float
    current_limit_A: float
    resistance_Ohm: Annotated[float, Limits(1e-3, 1e3)]
    armature_kg_m2: Annotated[float, Limits(1e-3, 1e5)]
    friction_Nm: Annotated[float, Limits(0.0, 1e4)]
    damping_Nms_rad: Annotated[float, Limits(0.0, 1e6)]
    position_gain_Nm_rad: Gain
    integral_gain_Nm_rads: Gain
    rate_gain_Nms_rad: Gain
    integral_limit_rads: Annotated[float, Limits(0.0, 1.0)]
    backlash_rad: float
    gear_stiffness_Nm_rad: float
    output_friction_Nm: float
    winding_K_W: Annotated[float, Limits(0.0, 1e3)]
    winding_s: Annotated[float, Limits(1.0, 1e6)]


@dataclass(frozen=True, slots=True)
class JointDescription:
    """Joint with its actuator, hardstops and limits of moves."""

    actuator: str
    hardstops_rad: Pair
    soft_limits_rad: Pair
    hardstop_stiffness_Nm_rad: float
    hardstop_press_Nm: float
    hardstop_rated_Nm: float
    load_error_Nm: float
    speed_rad_s: float
    acceleration_rad_s2: float
    jerk_rad_s3: float
    counter_zero_rad: Angle = 0.0
    """Motor angle at which the counter of the encoder reads 0; flight software does not know it."""


@dataclass(frozen=True, slots=True)
class JointDescriptions:
    """Joints from the rover outward."""

    azimuth: JointDescription
    elevation: JointDescription
    elbow: JointDescription
    wrist: JointDescription
    turret: JointDescription

    def by_name(self) -> dict[str, JointDescription]:
        """Return the joints by name, from the rover outward."""
        return {joint.name.lower(): getattr(self, joint.name.lower()) for joint in Joint}


@dataclass(frozen=True, slots=True)
class Lump:
    """Mass on one side of the spring of a link, in the link frame."""

    mass_kg: Annotated[float, Limits(1e-4, 200.0)]
    com_m: Vector3
    inertia_kg_m2: Vector3
    """Moments about the centre of mass and the axes of the link frame."""


@dataclass(frozen=True, slots=True)
class LinkDescription:
    """Link: transform to the frame at its end, spring, masses, thermal expansion."""

    transform: Transform6
    expansion_1_K: Expansion
    far: Lump
    near: Lump | None = None
    elastic_centre_m: Vector3 = (0.0, 0.0, 0.0)
    stiffness: Six = NO_SPRING
    """About x, y, z [N m/rad], then along x, y, z [N/m]; all 0 for a rigid link."""


@dataclass(frozen=True, slots=True)
class LinkDescriptions:
    """Links, named by the frame at their end."""

    arm1: LinkDescription
    arm2: LinkDescription
    arm3: LinkDescription
    arm4: LinkDescription
    arm5: LinkDescription
    arm6: LinkDescription

    def in_order(self) -> tuple[LinkDescription, ...]:
        """Return the links from the rover outward."""
        return (self.arm1, self.arm2, self.arm3, self.arm4, self.arm5, self.arm6)


@dataclass(frozen=True, slots=True)
class ToolDescription:
    """Tool on the turret; the x axis of its frame points outward."""

    transform: Transform6
    expansion_1_K: Expansion
    title: str | None = None
    """Name in sentences; None for that of the table."""
    pad_solref: Pair = (-6600.0, -66.0)
    """Stiffness and damping of its pads, negative, as MuJoCo's direct format scales them."""


@dataclass(frozen=True, slots=True)
class SwitchDescription:
    """Contact switch: a pad on a tool."""

    tool: str
    p_m: Vector3
    """Centre of the pad in the tool frame."""


@dataclass(frozen=True, slots=True)
class Shape:
    """Shape of a part: a capsule, a box, or a cylinder along z, by the fields that are given."""

    from_m: Vector3 | None = None
    to_m: Vector3 | None = None
    radius_m: float | None = None
    centre_m: Vector3 | None = None
    half_m: Vector3 | None = None
    turn_rad: float = 0.0
    half_length_m: float | None = None
    of: Literal["both", "plant", "flight"] = "both"
    """Model that has the shape."""

    @property
    def kind(self) -> str | None:
        """Return capsule, box or cylinder; None if the given fields make none of them."""
        given = {
            name
            for name in ("from_m", "to_m", "radius_m", "centre_m", "half_m", "half_length_m")
            if getattr(self, name) is not None
        }
        kinds = {
            "capsule": {"from_m", "to_m", "radius_m"},
            "box": {"centre_m", "half_m"},
            "cylinder": {"centre_m", "radius_m", "half_length_m"},
        }
        return next((kind for kind, names in kinds.items() if names == given), None)


Hull = dict[str, tuple[Shape, ...]]
"""Shapes of each part of a rover."""


@dataclass(frozen=True, slots=True)
class RoverDescription:
    """Rover that carries the arm: its frame V, parallel to RNAV, and its hull."""

    p_NoVo_N_m: Vector3
    """Origin of V, in which hull, arm1 and taught points are given."""
    hull: Hull
    """Shapes of its parts for collisions, in V."""


@dataclass(frozen=True, slots=True)
class PoseDescriptions:
    """Named poses, output angles."""

    stowed_rad: Joints5
    unstow_via_rad: tuple[Joints5, ...]
    ready_rad: Joints5
    hardstop_start_rad: Joints5
    hardstop_park_rad: Joints5
    hardstop_second_start_rad: Joints5
    bare_hardstop_start_rad: Joints5
    """This and the next two: about the same poses without a turret on Earth, where the search begins."""
    bare_hardstop_park_rad: Joints5
    bare_hardstop_second_start_rad: Joints5


@dataclass(frozen=True, slots=True)
class BuiltTolerances:
    """One sigma of what a built arm differs from the drawing; shares are log-normal."""

    frame_rad: SmallAngle
    frame_m: SmallLength
    hardstop_rad: SmallAngle
    resolver_rad: SmallAngle
    stiffness_share: Share
    backlash_share: Share
    mass_share: Share
    friction_share: Share
    com_m: SmallLength
    expansion_share: Share
    structure_sensor_K: Annotated[float, Limits(0.0, 20.0)]


@dataclass(frozen=True, slots=True)
class CalibratedTolerances:
    """One sigma of what the parameters of a calibrated arm differ from the arm."""

    frame_rad: SmallAngle
    frame_m: SmallLength
    hardstop_rad: SmallAngle
    stiffness_share: Share


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Tolerances of manufacture and of calibration."""

    built: BuiltTolerances
    calibrated: CalibratedTolerances


@dataclass(frozen=True, slots=True)
class ArmDescription:
    """Content of an `arm.toml`."""

    name: str
    title: str
    instrument: str
    """Tool that is placed if none is named."""
    actuators: dict[str, Actuator]
    joints: JointDescriptions
    links: LinkDescriptions
    tools: dict[str, ToolDescription]
    switches: dict[str, SwitchDescription]
    """Contact switches, in the order of the sensor word."""
    shapes: dict[str, tuple[Shape, ...]]
    """Shapes of links, turret and tools for collisions."""
    poses: PoseDescriptions
    tolerances: Tolerances
    teach: tuple[TeachPoint, ...] = ()
    flight: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Flight parameters that replace the defaults of all arms."""
    rover: RoverDescription | None = None
    """Rover that carries the arm; None for Curiosity's."""
    workspace: Workspace | None = None
    """Workspace; None for the primary one of the paper."""

    def actuator_of(self, joint: str) -> Actuator:
        """Return the actuator of a joint."""
        return self.actuators[self.joints.by_name()[joint].actuator]


VISCOUS_COLD: Final = 8.0
"""Factor on the viscous friction at 20 degC that gives that at -55 degC."""
LINK_PARTS: Final = ("link2", "link3", "link4", "link5", "turret")
"""Parts with shapes, beside the tools."""
_ADAPTER: Final = TypeAdapter(ArmDescription)


def read_description(text: str, path: str) -> ArmDescription:
    """Read the text of an `arm.toml`; BadArm names each field missing, not known or of a wrong type."""
    try:
        table = parse_toml(text, path)
    except RobotError as error:
        raise BadArm(str(error)) from error
    try:
        return _ADAPTER.validate_json(json.dumps(table, default=str), strict=True, extra="forbid")
    except ValidationError as error:
        faults = describe_faults(ArmDescription, error)
        raise BadArm("\n".join(f"{path}: {fault}" for fault in faults)) from error


@cache
def default_rover(path: Path) -> RoverDescription:
    """Read the rover of the arms whose file gives none."""
    return TypeAdapter(RoverDescription).validate_python(read_toml(path))


def on_rover(arm: ArmDescription, rover: RoverDescription) -> tuple[ArmDescription, Hull]:
    """Convert what an arm and its rover have in frame V to RMECH.

    RMECH is at the same place on every rover, so that all that reads it can take any arm.
    """
    shift_m = np.array(rover.p_NoVo_N_m) - P_NR_M
    if not shift_m.any():
        return arm, rover.hull

    def moved(p_m: Vector3) -> Vector3:
        return vector3(np.array(p_m) + shift_m)

    hull = {
        part: tuple(move_shape(shape, shift_m) for shape in shapes) for part, shapes in rover.hull.items()
    }
    base = arm.links.arm1
    base = replace(
        base,
        transform=_move_end(base.transform, shift_m),
        elastic_centre_m=moved(base.elastic_centre_m),
        far=replace(base.far, com_m=moved(base.far.com_m)),
    )
    teach = tuple(replace(point, p_RoTo_R_m=moved(point.p_RoTo_R_m)) for point in arm.teach)
    return replace(arm, links=replace(arm.links, arm1=base), teach=teach), hull


def move_shape(shape: Shape, shift_m: Array) -> Shape:
    """Return a shape at another place, rounded to a picometre."""
    given = {name: getattr(shape, name) for name in ("from_m", "to_m", "centre_m")}
    moved: dict[str, Any] = {
        name: vector3(np.round(p + shift_m, 12)) for name, p in given.items() if p is not None
    }
    return replace(shape, **moved)


def _move_end(X: Transform6, shift_m: Array) -> Transform6:
    """Return a transform with the same turn, whose end is shifted in the axes of its start."""
    axes = [
        transform6_to_pose(Transform6(theta_rad=X.theta_rad, beta_rad=X.beta_rad, **{name: 1.0})).p
        for name in ("d_m", "b_m", "a_m")
    ]
    d_m, b_m, a_m = np.linalg.solve(np.column_stack(axes), transform6_to_pose(X).p + shift_m)
    return replace(X, d_m=float(d_m), b_m=float(b_m), a_m=float(a_m))
