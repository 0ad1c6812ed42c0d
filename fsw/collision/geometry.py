"""Collision geometry: the shapes of arm and rover as arrays of rounded boxes, each fixed to a frame.

A rounded box is all points within a radius of a box. The box of a capsule has a length only; the box of a
sphere is a point.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.params import ArmGeometry, Box, Capsule, Params, PartGeometry, RoverPart
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import IDENTITY, Array, Flags, Pose, cross, norm, rotation_z, stack_poses

LINK_PARTS: Final = tuple(field.name for field in fields(ArmGeometry))
"""Parts of the arm but its tools, from the shoulder outward."""
GROUND: Final = -2
"""Index of level ground among the obstacles."""
SURFACE: Final = -1
"""Index of the surface of a target among the obstacles: the last."""
LINK_TITLES: Final = {
    "link2": "upper arm",
    "link3": "forearm",
    "link4": "wrist",
    "link5": "turret joint",
    "turret": "turret",
}
TURRET_FRAME: Final = 5
FRAME_OF: Final = {"link2": 1, "link3": 2, "link4": 3, "link5": 4}
"""Index of the link that carries a part, 0 for link 1; the other parts are on the turret, in frame Arm6."""
SURFACE_FRAME: Final = FRAME_OF["link4"]
"""First frame whose parts keep away from a surface: from the wrist outward."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetSurface:
    """Plane surface of a target in RMECH; the rock is below it."""

    p_R_m: Array
    """Point of the surface, (3,), or one for each pose of a batch, (3, n)."""
    normal_R: Array
    """Unit normal, out of the rock, (3,)."""
    radius_m: float = np.inf
    """Radius of the half ball of rock about the point."""


@dataclass(frozen=True, slots=True, eq=False)
class RoundedBoxes:
    """Rounded boxes, batch (m); each belongs to a part and is fixed to a frame."""

    part: NDArray[np.intp]
    """Index among the parts of the arm or the obstacles, (m,)."""
    carrier: NDArray[np.intp]
    """Index of the frame that each is fixed to, (m,); see FRAME_OF."""
    X_CS: Pose
    """Pose of each box in that frame; the box is aligned with the axes of S."""
    half_m: Array
    """Half sizes, (3, m)."""
    radius_m: Array
    """Radius of the rounding, (m,)."""
    bounding_radius_m: Array
    """Distance of the farthest point from the centre, (m,)."""

    @property
    def is_capsule(self) -> Flags:
        """Return which boxes have a length only, shape (m,)."""
        is_capsule: Flags = (self.half_m[1] == 0) & (self.half_m[2] == 0)
        return is_capsule


@dataclass(frozen=True, slots=True, eq=False)
class CollisionGeometry:
    """Shapes of arm (in link frames) and rover (in RMECH), and of level ground."""

    parts: tuple[str, ...]
    """Parts of the arm, from the shoulder outward: links, turret, tools."""
    obstacles: tuple[str, ...]
    """Parts of the rover, the ground, and the surface of a target."""
    titles: Mapping[str, str]
    """Names of parts and obstacles in sentences."""
    arm: RoundedBoxes
    rover: RoundedBoxes
    ground_z_m: float
    surface_radius_m: float
    """Radius within which a surface counts: no part of the turret is farther from the tip of a tool."""
    lever_m: Array
    """Upper bound of the distance of any point of the arm from each joint axis, (5,)."""


def build_collision_geometry(params: Params, arm: Arm) -> CollisionGeometry:
    """Build the collision geometry from the shapes of the parameters."""
    shapes = params.collision
    parts = {name: getattr(shapes.arm, name) for name in LINK_PARTS}
    parts |= {tool.name: tool.geometry for tool in params.tools}
    arm_boxes = _collect(
        (part, FRAME_OF.get(name, TURRET_FRAME), arm.X_FT.get(name, IDENTITY), shape)
        for part, name in enumerate(parts)
        for shape in _shapes_of(parts[name])
    )
    rover_boxes = _collect(
        (obstacle, 0, IDENTITY, shape)
        for obstacle, part in enumerate(shapes.rover)
        for shape in _shapes_of(part)
    )
    obstacles = (*(part.name for part in shapes.rover), "ground", "surface")
    titles = {name: name.replace("_", " ") for name in obstacles} | LINK_TITLES
    titles |= {tool.name: tool.title for tool in params.tools}
    return CollisionGeometry(
        parts=tuple(parts),
        obstacles=obstacles,
        titles=titles,
        arm=arm_boxes,
        rover=rover_boxes,
        ground_z_m=shapes.ground_z_m,
        surface_radius_m=_bound_turret(arm, arm_boxes),
        lever_m=_bound_levers(arm, arm_boxes),
    )


def _shapes_of(part: PartGeometry | RoverPart) -> tuple[Capsule | Box, ...]:
    return (*part.capsules, *part.boxes)


def _collect(placed: Iterable[tuple[int, int, Pose, Capsule | Box]]) -> RoundedBoxes:
    """Collect shapes, each with its part, its carrier and the frame X_CP in which its numbers are given."""
    parts, carriers, X_CP, shapes = zip(*placed, strict=True)
    X_PS, halves, radii = zip(*map(_to_rounded_box, shapes), strict=True)
    X_CS = [X @ Y for X, Y in zip(X_CP, X_PS, strict=True)]
    half, radius = np.array(halves).T, np.array(radii)
    return RoundedBoxes(
        part=np.array(parts),
        carrier=np.array(carriers),
        X_CS=stack_poses(X_CS),
        half_m=half,
        radius_m=radius,
        bounding_radius_m=norm(half) + radius,
    )


@lru_cache(maxsize=512)  # every configuration of an arm has the same shapes
def _to_rounded_box(shape: Capsule | Box) -> tuple[Pose, Array, float]:
    """Convert a shape to a rounded box: pose in the frame of its part, half size and radius."""
    if isinstance(shape, Box):
        X_PS = Pose(rotation_z(np.array(shape.turn_rad)), np.array(shape.centre_m))
        return X_PS, np.array(shape.half_m), 0.0
    start, end = np.array(shape.from_m), np.array(shape.to_m)
    length = float(np.linalg.norm(end - start))
    X_PS = Pose(_rotation_along(end - start), 0.5 * (start + end))
    return X_PS, np.array([0.5 * length, 0.0, 0.0]), shape.radius_m


def _rotation_along(v: Array) -> Array:
    """Return a rotation whose x axis is along a vector; the identity for a vector of nearly no length."""
    length = np.linalg.norm(v)
    if length < 1e-9:
        return np.eye(3)
    x = v / length
    y = cross(np.eye(3)[int(np.abs(x).argmin())], x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, cross(x, y)], axis=1)


def _bound_turret(arm: Arm, boxes: RoundedBoxes) -> float:
    """Bound the distance of any part of the turret from the tip of any tool."""
    on_turret = boxes.carrier == TURRET_FRAME
    p_m, radius_m = boxes.X_CS.p[:, on_turret], boxes.bounding_radius_m[on_turret]
    return float(max(np.max(norm(p_m - X_FT.p[:, None]) + radius_m) for X_FT in arm.X_FT.values()))


def _bound_levers(arm: Arm, boxes: RoundedBoxes) -> Array:
    """Bound the distance of any shape from each joint axis: the sum of link lengths and of shape extents."""
    link = norm(arm.X_CF.p + arm.p_LC_m)[1:]
    to_carrier = np.concatenate([np.zeros(1), np.cumsum(link)])
    beyond = to_carrier[boxes.carrier] + norm(boxes.X_CS.p) + boxes.bounding_radius_m
    levers = [np.max(beyond - to_carrier[j], where=boxes.carrier >= j, initial=0.0) for j in range(5)]
    return np.array(levers)
