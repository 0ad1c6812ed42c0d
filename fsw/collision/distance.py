"""Distances between rounded boxes, and the clearances of the arm to rover, level ground and a surface.

A distance is exact for the shapes. Each shape encloses the part that it stands for, so a part is never closer
than its shape. Batches are on the trailing axes.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.collision.geometry import GROUND, SURFACE, SURFACE_FRAME, CollisionGeometry, TargetSurface
from fsw.kinematics.chain import Frames
from fsw.kinematics.transforms import Array, Pose, dot, inverse, norm, rotate_back

ROUNDING_M: Final = 1e-5
"""Rounding error: a part that starts too close may come this much closer."""

BELOW_M: Final = 0.02
"""Depth below a surface that errors of surface and arm do not explain."""
LEAST_ROCK_M: Final = 0.1
"""Least radius of a rock to touch: twice the distance from a tip to the ends of its contact switches."""
UP: Final = np.array([0.0, 0.0, -1.0])
"""Normal of level ground in RMECH."""

BOX_PAIRS: Final = 5
"""Pairs with a capsule of the arm that take as long as one with a box, which has twelve edges."""

Indices = NDArray[np.intp]

_ALONG: Final = np.repeat(np.eye(3), 4, axis=1)
_SIDES: Final = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]).T
_FROM: Final = np.stack(
    [
        np.concatenate([np.full(4, -1.0), _SIDES[0], _SIDES[0]]),
        np.concatenate([_SIDES[0], np.full(4, -1.0), _SIDES[1]]),
        np.concatenate([_SIDES[1], _SIDES[1], np.full(4, -1.0)]),
    ]
)
"""Start points of the twelve edges of a cube of half size 1; `_ALONG` has their directions, x first."""


@dataclass(frozen=True, slots=True)
class ClearanceViolation:
    """Part of the arm that comes too close to an obstacle on a path."""

    part: str
    obstacle: str
    part_title: str
    """Name of the part in sentences."""
    obstacle_title: str
    distance_m: float
    """Least distance on the path; at most 0 where they meet."""
    least_m: float
    """Distance that was to be kept."""
    first: int
    """Index of the first pose that is too close."""

    @property
    def reason(self) -> str:
        """Return the sentence for a refusal."""
        if self.distance_m <= 0 and self.obstacle == "surface":
            return f"the {self.part_title} would be {-1e3 * self.distance_m:.0f} mm below the surface"
        if self.distance_m <= 0:
            return f"the {self.part_title} meets the {self.obstacle_title}"
        return (
            f"the {self.part_title} comes within {1e3 * self.distance_m:.1f} mm of the "
            f"{self.obstacle_title}, "
            f"at least {1e3 * self.least_m:.1f} mm are to be kept"
        )


@dataclass(frozen=True, slots=True, eq=False)
class PathClearance:
    """Clearance of the poses of a path that have been looked at, in their order."""

    least_m: Array
    """Distance to be kept by each part from each obstacle, (parts, obstacles)."""
    nearest_m: Array
    """Least distance of each part from each obstacle so far, (parts, obstacles)."""
    poses: int = 0
    """Number of poses that have been looked at."""
    violation: tuple[int, int, int] | None = None
    """Part, obstacle and pose of the first distance that is too small."""


def begin_clearance(clearance_m: Array, padding_m: float, touching: str | None = None) -> PathClearance:
    """Begin a path with the clearance of its first pose.

    A part that starts closer than the padding may stay as close or move away, so that the arm can leave. Only
    where a tool touches may a part start below the surface.

    Args:
        clearance_m: Distances of `compute_clearances` at the first pose, shape (parts, obstacles).
        padding_m: Distance to be kept.
        touching: Tool that is to touch; no distance is required of it.
    """
    least_m = np.minimum(padding_m, clearance_m - ROUNDING_M)
    if touching is None:
        least_m[:, SURFACE] = np.maximum(least_m[:, SURFACE], 0.0)
    return PathClearance(least_m, np.full_like(least_m, np.inf))


def follow_clearance(path: PathClearance, clearance_m: Array) -> PathClearance:
    """Look at the next poses of a path, by their distances of `compute_clearances`."""
    nearest_m = np.minimum(path.nearest_m, clearance_m.min(axis=-1))
    violation, bad = path.violation, clearance_m < path.least_m[..., None]
    if violation is None and bad.any():
        first = int(bad.any(axis=(0, 1)).argmax())
        short = np.where(bad[..., first], clearance_m[..., first] - path.least_m, np.inf)
        part, obstacle = np.unravel_index(int(short.argmin()), short.shape)
        violation = int(part), int(obstacle), path.poses + first
    return PathClearance(path.least_m, nearest_m, path.poses + clearance_m.shape[-1], violation)


def describe_violation(geometry: CollisionGeometry, path: PathClearance) -> ClearanceViolation | None:
    """Describe the first violation of a path, or return None if there is none."""
    if path.violation is None:
        return None
    part, obstacle, first = path.violation
    return ClearanceViolation(
        geometry.parts[part],
        geometry.obstacles[obstacle],
        geometry.titles[geometry.parts[part]],
        geometry.titles[geometry.obstacles[obstacle]],
        float(path.nearest_m[part, obstacle]),
        float(path.least_m[part, obstacle]),
        first,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Clearances:
    """Distances of the parts of the arm to the obstacles in n poses."""

    near_m: Array
    """Distance of each part to each obstacle within the bound, else infinite, (parts, obstacles, n)."""
    beyond_m: Array
    """Lower bound of all other distances, which are beyond the bound, (n,)."""


def compute_clearances(
    geometry: CollisionGeometry,
    frames: Frames,
    within_m: float,
    touching: str | None = None,
    surface: TargetSurface | None = None,
    most_pairs: int | None = None,
) -> Clearances:
    """Compute the distances of each part of the arm to each obstacle, exactly where they are within a bound.

    Those of a tool that is touching, and to a surface that is not there, do not count.

    Args:
        most_pairs: Most pairs of shapes whose distance is computed exactly, where a box of the arm counts as
            several. Poses for which it does not suffice are left out at the end, but the first two are kept;
            None for all.
    """
    arm, rover, X_RS = geometry.arm, geometry.rover, place_shapes(geometry, frames)
    ignored = np.zeros(arm.part.size, bool)
    if touching is not None:
        ignored = arm.part == geometry.parts.index(touching)
    bound = _bound_distances(geometry, X_RS.p)
    bound[:, ignored] = np.inf
    is_near = bound <= within_m
    if most_pairs is not None:
        pairs = np.where(arm.is_capsule, 1, BOX_PAIRS) @ is_near.sum(axis=0)
        n = max(int((np.cumsum(pairs) <= most_pairs).sum()), 2)
        X_RS, bound, is_near = X_RS[:, :n], bound[..., :n], is_near[..., :n]
    near_m = np.full((len(geometry.parts), len(geometry.obstacles), X_RS.p.shape[-1]), np.inf)
    beyond_m = np.where(is_near, np.inf, bound).min(axis=(0, 1))
    obstacle, shape, pose = np.nonzero(is_near)
    distance = _compute_distances(geometry, X_RS[shape, pose], shape, obstacle)
    is_near = distance <= within_m
    np.minimum.at(
        near_m,
        (arm.part[shape][is_near], rover.part[obstacle][is_near], pose[is_near]),
        distance[is_near],
    )
    np.minimum.at(beyond_m, pose[~is_near], distance[~is_near])
    ground = TargetSurface(np.array([0.0, 0.0, geometry.ground_z_m]), UP)
    planes = {GROUND: _compute_heights(geometry, X_RS, ground)}
    if surface is not None:
        planes[SURFACE] = _compute_surface_distances(geometry, X_RS, surface)
    for plane, height in planes.items():
        height[ignored] = np.inf
        is_near = height <= within_m
        shape, pose = np.nonzero(is_near)
        np.minimum.at(near_m[:, plane], (arm.part[shape], pose), height[shape, pose])
        beyond_m = np.minimum(beyond_m, np.where(is_near, np.inf, height).min(axis=0))
    return Clearances(near_m, beyond_m)


def compute_surface_heights(
    geometry: CollisionGeometry, frames: Frames, surface: TargetSurface, touching: str
) -> Array:
    """Compute the least height of each part above a plane surface in n poses, (parts,) [m].

    A tool that is to touch, and parts that need not keep away from a surface, are infinitely high.
    """
    arm, height_m = geometry.arm, np.full(len(geometry.parts), np.inf)
    lowest_m = _compute_heights(geometry, place_shapes(geometry, frames), surface).min(axis=1)
    counts = (arm.carrier >= SURFACE_FRAME) & (arm.part != geometry.parts.index(touching))
    np.minimum.at(height_m, arm.part[counts], lowest_m[counts])
    return height_m


def measure_motion(geometry: CollisionGeometry, frames: Frames) -> Array:
    """Measure how far the shapes of the arm move from each pose (n) to the next, (n - 1,) [m].

    No point of the core of a shape, to which its rounding is added, moves farther in a straight line.
    """
    X_RS = place_shapes(geometry, frames)
    shift_m = norm(np.diff(X_RS.p))
    turned_m = np.einsum("kmn,km->mn", norm(np.diff(X_RS.R)), geometry.arm.half_m)
    moved_m: Array = (shift_m + turned_m).max(axis=0)
    return moved_m


def place_shapes(geometry: CollisionGeometry, frames: Frames) -> Pose:
    """Place the shapes of the arm in RMECH: poses of the m shapes, batch (m, n)."""
    arm, X_RC = geometry.arm, _collect_carriers(frames)
    R_RC = X_RC.R[:, :, arm.carrier]
    p_RS = np.einsum("ijmn,jm->imn", R_RC, arm.X_CS.p) + X_RC.p[:, arm.carrier]
    return Pose(np.einsum("ijmn,jkm->ikmn", R_RC, arm.X_CS.R), p_RS)


def _collect_carriers(frames: Frames) -> Pose:
    """Return the poses of links 1 to 5 and Arm6 in RMECH, batch (6, n)."""
    link, end = frames.X_RL, frames.X_RF
    return Pose(
        np.concatenate([link.R[:, :, 1:], end.R[:, :, 5:]], axis=2),
        np.concatenate([link.p[:, 1:], end.p[:, 5:]], axis=1),
    )


def _compute_heights(geometry: CollisionGeometry, X_RS: Pose, plane: TargetSurface) -> Array:
    """Compute the height of the lowest point of each shape of the arm above a plane, (m, n)."""
    arm, down = geometry.arm, -plane.normal_R
    extent = np.abs(np.einsum("i,ikmn->kmn", down, X_RS.R))
    lowest = (
        np.einsum("i,imn->mn", down, X_RS.p)
        + np.einsum("kmn,km->mn", extent, arm.half_m)
        + arm.radius_m[:, None]
    )
    height: Array = down @ plane.p_R_m - lowest
    return height


def _compute_surface_distances(geometry: CollisionGeometry, X_RS: Pose, surface: TargetSurface) -> Array:
    """Bound the distances of the shapes of the arm, (m, n), to the half ball of rock below a surface."""
    beside = _compute_distances_beside(geometry, X_RS, surface) - surface.radius_m
    distance = np.maximum(_compute_heights(geometry, X_RS, surface), beside)
    distance[geometry.arm.carrier < SURFACE_FRAME] = np.inf
    return distance


def _compute_distances_beside(geometry: CollisionGeometry, X_RS: Pose, surface: TargetSurface) -> Array:
    """Compute the distances of the shapes of the arm, (m, n), to the point of a surface."""
    p_S = rotate_back(X_RS.R, surface.p_R_m.reshape(3, 1, -1) - X_RS.p)
    return point_distance(p_S, geometry.arm.half_m[:, :, None]) - geometry.arm.radius_m[:, None]


def limit_surface(geometry: CollisionGeometry, frames: Frames, surface: TargetSurface) -> TargetSurface:
    """Limit the radius of a surface by the parts of the arm that start below it, where no rock can be.

    Its half ball ends half-way to the nearest of these parts.

    Args:
        frames: Frames of the links in RMECH along a path, batch (n); the first is its start.
    """
    X_RS = place_shapes(geometry, Frames(*(X[:, :1] for X in (frames.X_RL, frames.X_LD, frames.X_RF))))
    height = _compute_heights(geometry, X_RS, surface)[:, 0]
    is_below = (geometry.arm.carrier >= SURFACE_FRAME) & (height < -BELOW_M)
    nearest_m = _compute_distances_beside(geometry, X_RS, surface)[is_below, 0].min(initial=np.inf)
    return replace(surface, radius_m=min(surface.radius_m, max(0.5 * float(nearest_m), LEAST_ROCK_M)))


def _bound_distances(geometry: CollisionGeometry, p_RS: Array) -> Array:
    """Bound the distances (r, m, n) of the shapes of the arm to those of the rover, by bounding spheres."""
    arm, rover = geometry.arm, geometry.rover
    r, (_, m, n) = rover.part.size, p_RS.shape
    # one product turns all centres into the axes of all obstacles
    p_O = np.swapaxes(rover.X_CS.R, 0, 2).reshape(r, 3, 3) @ p_RS.reshape(3, m * n)
    p_O -= np.einsum("ijr,ir->rj", rover.X_CS.R, rover.X_CS.p)[:, :, None]
    p_O = np.abs(p_O).reshape(r, 3, m, n)
    p_O -= rover.half_m.T[:, :, None, None]
    np.maximum(p_O, 0.0, out=p_O)
    distance: Array = np.sqrt(np.einsum("rimn,rimn->rmn", p_O, p_O))
    distance -= arm.bounding_radius_m[:, None] + rover.radius_m[:, None, None]
    return distance


def _compute_distances(geometry: CollisionGeometry, X_RS: Pose, shape: Indices, obstacle: Indices) -> Array:
    """Compute the distances (k,) of pairs of shapes of the arm, at poses X_RS, and of the rover."""
    X_RO, half_S, half_O = (
        geometry.rover.X_CS[obstacle],
        geometry.arm.half_m[:, shape],
        geometry.rover.half_m[:, obstacle],
    )
    X_OS = inverse(X_RO) @ X_RS
    distance = np.empty(shape.size)
    line_S, line_O = geometry.arm.is_capsule[shape], geometry.rover.is_capsule[obstacle]
    one, other, neither = line_S, ~line_S & line_O, ~line_S & ~line_O
    # most poses have pairs of few kinds, and each kind takes its time even without a pair
    if one.any():
        distance[one] = edges_distance(X_OS[one], half_S[:, one], half_O[:, one], edges=1)
    if other.any():
        distance[other] = edges_distance(inverse(X_OS[other]), half_O[:, other], half_S[:, other], edges=1)
    if neither.any():
        distance[neither] = box_distance(X_OS[neither], half_O[:, neither], half_S[:, neither])
    return distance - geometry.arm.radius_m[shape] - geometry.rover.radius_m[obstacle]


def box_distance(X_AB: Pose, half_A_m: Array, half_B_m: Array) -> Array:
    """Compute the distance [m] of box A to box B, shape (n,); 0 where the boxes overlap.

    One of the two nearest points lies on an edge of its box. A corner is the end of an edge.

    Args:
        X_AB: Pose of box B in the axes of box A, batch (n).
        half_A_m: Half sizes of box A, shape (3, n).
        half_B_m: Half sizes of box B, shape (3, n).
    """
    X_BA = inverse(X_AB)
    return np.minimum(edges_distance(X_AB, half_B_m, half_A_m), edges_distance(X_BA, half_A_m, half_B_m))


def edges_distance(X_BE: Pose, half_E_m: Array, half_B_m: Array, edges: int = 12) -> Array:
    """Compute the least distance [m] of the edges of box E to box B, shape (n,).

    Args:
        X_BE: Pose of box E in the axes of box B, batch (n).
        half_E_m: Half sizes of box E, shape (3, n).
        half_B_m: Half sizes of box B, shape (3, n).
        edges: Number of edges to use; 1 for a box that has a length along x only.
    """
    p_EoF_E = _FROM[:, :edges, None] * half_E_m[:, None]
    along_E = 2 * _ALONG[:, :edges, None] * half_E_m[:, None]
    p_B = np.einsum("ijn,jkn->ikn", X_BE.R, p_EoF_E) + X_BE.p[:, None]
    along_B = np.einsum("ijn,jkn->ikn", X_BE.R, along_E)
    nearest: Array = segment_distance(p_B, along_B, half_B_m[:, None]).min(axis=0)
    return nearest


def segment_distance(p_m: Array, along_m: Array, half_m: Array) -> Array:
    """Compute the distance [m] of segments to boxes about the origin, shape (...).

    The squared distance of the point p + t * along is convex in t. Its slope is linear between breakpoints:
    the values of t at which the segment crosses the plane of a face. Its root lies between two adjacent ones.

    Args:
        p_m: Start of each segment in the axes of its box, shape (3, ...).
        along_m: End less start of each segment, same shape.
        half_m: Half sizes of each box, same shape.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossings = np.concatenate([(half_m - p_m) / along_m, (-half_m - p_m) / along_m])
    breaks = np.clip(np.nan_to_num(crossings, nan=0.0), 0.0, 1.0)
    breaks = np.concatenate([breaks, np.zeros((1, *breaks.shape[1:])), np.ones((1, *breaks.shape[1:]))])
    slope = sum(along_m[k] * _outside(p_m[k] + breaks * along_m[k], half_m[k]) for k in range(3))
    before = np.where(slope <= 0, breaks, 0.0).max(axis=0)
    after = np.where(slope > 0, breaks, 1.0).min(axis=0)
    fall, rise = (dot(along_m, _outside(p_m + t * along_m, half_m)) for t in (before, after))
    share = np.divide(-fall, rise - fall, out=np.zeros_like(rise), where=rise > fall)
    t = before + np.clip(share, 0.0, 1.0) * (after - before)
    offset = _outside(p_m + t * along_m, half_m)
    distance: Array = np.sqrt(dot(offset, offset))
    return distance


def point_distance(p_m: Array, half_m: Array) -> Array:
    """Compute the distance [m] of points (3, ...) to boxes of half sizes (3, ...) at the origin; 0 inside."""
    offset = _outside(p_m, half_m)
    distance: Array = np.sqrt(dot(offset, offset))
    return distance


def _outside(x_m: Array, half_m: Array) -> Array:
    """Return the vector from the nearest point of a box about the origin to each point."""
    vector: Array = x_m - np.minimum(np.maximum(x_m, -half_m), half_m)
    return vector
