"""Parameters of collision: what the parts of the arm and of the rover are inside of. SI units."""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.types import Angle, Limits, Vector3


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within a radius of a segment; from one end to the other."""

    from_m: Vector3
    """One end of the segment."""
    to_m: Vector3
    """The other end."""
    radius_m: Annotated[float, Limits(0.001, 1.0)]
    """How far from the segment it reaches."""


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes of its frame, turned about z."""

    centre_m: Vector3
    """Its middle."""
    half_m: Vector3
    """Half its edges, x, y, z."""
    turn_rad: Angle = 0.0
    """How far it is turned about z."""


@dataclass(frozen=True, slots=True)
class PartGeometry:
    """What a part is inside of."""

    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True)
class ArmGeometry:
    """The parts of the arm: links in their frames before their springs, the turret in Arm6, tools in theirs.

    The housing of azimuth and elevation is not among them: it turns between the plates of its bracket.
    """

    link2: PartGeometry
    link3: PartGeometry
    link4: PartGeometry
    link5: PartGeometry
    turret: PartGeometry
    drill: PartGeometry
    drt: PartGeometry
    mahli: PartGeometry
    apxs: PartGeometry
    portion: PartGeometry


@dataclass(frozen=True, slots=True)
class RoverGeometry:
    """The parts of the rover, in RMECH."""

    chassis: PartGeometry
    shoulder_bracket: PartGeometry
    bit_box_1: PartGeometry
    bit_box_2: PartGeometry
    port_wheels: PartGeometry
    starboard_wheels: PartGeometry
    mast: PartGeometry
    mast_head: PartGeometry
    antenna: PartGeometry


@dataclass(frozen=True, slots=True)
class CollisionParams:
    """What the arm is not to meet, and how far it keeps from it."""

    padding_m: Annotated[float, Limits(0.0, 0.2)]
    """Distance that parts keep from each other."""
    ground_z_m: Annotated[float, Limits(0.0, 5.0)]
    """Height of level ground in RMECH; z points down."""
    arm: ArmGeometry
    rover: RoverGeometry
