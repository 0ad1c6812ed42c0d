"""Parameters of the collision check: shapes that enclose the parts of the arm and of the rover. SI units."""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.types import Angle, Limits, Vector3


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
