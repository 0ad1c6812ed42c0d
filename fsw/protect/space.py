"""The shapes of arm and rover as arrays: rounded boxes, each fixed to a frame.

A rounded box is all points within a radius of a box. A capsule is one whose box has a length only.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.joints import Tool
from fsw.dictionary.params import Params
from fsw.dictionary.shapes import ArmShapes, Box, Capsule, RoverShapes, Shapes
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import IDENTITY, Array, Flags, Pose, batched, cross, norm, rotation_z

PARTS: Final = tuple(field.name for field in fields(ArmShapes))
"""Of the arm, from the shoulder outward."""
OBSTACLES: Final = (*(field.name for field in fields(RoverShapes)), "ground")
GROUND: Final = OBSTACLES.index("ground")
TURRET_FRAME: Final = 5
CARRIER: Final = {"link2": 1, "link3": 2, "link4": 3, "link5": 4}
"""Which of links 1 to 5 carries a part; the others are on the turret, in frame Arm6."""


@dataclass(frozen=True, slots=True, eq=False)
class Solids:
    """Rounded boxes (m), each of a part and fixed to a frame."""

    part: NDArray[np.intp]
    carrier: NDArray[np.intp]
    """The frame they are fixed to."""
    X_CS: Pose
    """Where they are in it; the box lies along the axes of S."""
    half_m: Array
    """(3, m)."""
    radius_m: Array
    reach_m: Array
    """Farthest point from the middle."""

    @property
    def thin(self) -> Flags:
        """Which are capsules: their boxes have a length only."""
        thin: Flags = (self.half_m[1] == 0) & (self.half_m[2] == 0)
        return thin


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """The arm's shapes and those of the rover, in RMECH; what follows from the parameters once."""

    arm: Solids
    rover: Solids
    ground_z_m: float
    lever_m: Array
    """How far any point of the arm can be from each joint's axis, (5)."""


def space_from(params: Params, arm: Arm) -> Space:
    """The shapes of these parameters as arrays."""
    shapes, tools = params.collision, {tool.name.lower(): arm.X_FT[tool] for tool in Tool}
    solids = _solids(
        (part, CARRIER.get(name, TURRET_FRAME), tools.get(name, IDENTITY), shape)
        for part, name in enumerate(PARTS)
        for shape in _of(getattr(shapes.arm, name))
    )
    hull = _solids(
        (obstacle, 0, IDENTITY, shape)
        for obstacle, name in enumerate(OBSTACLES[:GROUND])
        for shape in _of(getattr(shapes.rover, name))
    )
    return Space(solids, hull, shapes.ground_z_m, _levers(arm, solids))


def _of(part: Shapes) -> tuple[Capsule | Box, ...]:
    return (*part.capsules, *part.boxes)


def _solids(placed: Iterable[tuple[int, int, Pose, Capsule | Box]]) -> Solids:
    """Shapes with their part, their carrier, and the frame in it that they are given in."""
    parts, carriers, X_CP, shapes = zip(*placed, strict=True)
    X_PS, halves, radii = zip(*map(_rounded, shapes), strict=True)
    X_CS = [X @ Y for X, Y in zip(X_CP, X_PS, strict=True)]
    half, radius = np.array(halves).T, np.array(radii)
    return Solids(
        part=np.array(parts),
        carrier=np.array(carriers),
        X_CS=batched(X_CS),
        half_m=half,
        radius_m=radius,
        reach_m=norm(half) + radius,
    )


def _rounded(shape: Capsule | Box) -> tuple[Pose, Array, float]:
    """A shape as a rounded box: where it is in its part's frame, half size and radius."""
    if isinstance(shape, Box):
        X_PS = Pose(rotation_z(np.array(shape.turn_rad)), np.array(shape.centre_m))
        return X_PS, np.array(shape.half_m), 0.0
    start, end = np.array(shape.from_m), np.array(shape.to_m)
    length = float(np.linalg.norm(end - start))
    X_PS = Pose(_along(end - start), 0.5 * (start + end))
    return X_PS, np.array([0.5 * length, 0.0, 0.0]), shape.radius_m


def _along(v: Array) -> Array:
    """A rotation whose x axis is along a vector; any, if it has hardly a length."""
    length = np.linalg.norm(v)
    if length < 1e-9:
        return np.eye(3)
    x = v / length
    y = cross(np.eye(3)[int(np.abs(x).argmin())], x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, cross(x, y)], axis=1)


def _levers(arm: Arm, solids: Solids) -> Array:
    """Upper bounds, whatever the angles: the chain stretched out from each joint to the end of each solid."""
    link = norm(arm.X_CF.p + arm.p_LC_m)[1:]
    to_carrier = np.concatenate([np.zeros(1), np.cumsum(link)])
    beyond = to_carrier[solids.carrier] + norm(solids.X_CS.p) + solids.reach_m
    levers = [np.max(beyond - to_carrier[j], where=solids.carrier >= j, initial=0.0) for j in range(5)]
    return np.array(levers)
