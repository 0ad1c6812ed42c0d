"""Parameters of collision: what the parts of the arm and of the rover are inside of. SI units."""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.commands import Vector3
from fsw.dictionary.limits import Angle, Limits


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
class Shapes:
    """What a part is inside of."""

    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True)
class ArmShapes:
    """The parts of the arm: links in their frames before their springs, the turret in Arm6, tools in theirs.

    The housing of azimuth and elevation is not among them: it turns between the plates of its bracket.
    """

    link2: Shapes
    link3: Shapes
    link4: Shapes
    link5: Shapes
    turret: Shapes
    drill: Shapes
    drt: Shapes
    mahli: Shapes
    apxs: Shapes
    portion: Shapes


@dataclass(frozen=True, slots=True)
class RoverShapes:
    """The parts of the rover, in RMECH."""

    chassis: Shapes
    shoulder_bracket: Shapes
    bit_box_1: Shapes
    bit_box_2: Shapes
    port_wheels: Shapes
    starboard_wheels: Shapes
    mast: Shapes
    mast_head: Shapes
    antenna: Shapes


@dataclass(frozen=True, slots=True)
class CollisionParams:
    """What the arm is not to meet, and how far it keeps from it."""

    padding_m: Annotated[float, Limits(0.0, 0.2)]
    """Distance that parts keep from each other."""
    ground_z_m: Annotated[float, Limits(0.0, 5.0)]
    """Height of level ground in RMECH; z points down."""
    arm: ArmShapes
    rover: RoverShapes
