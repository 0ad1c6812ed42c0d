"""How close the arm comes to the rover and to level ground, by the shapes of the parameters.

The distances are exactly those of the shapes. The shapes are around what they stand for, so that nothing is
closer than it seems.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.joints import Tool
from fsw.kinematics.chain import Frames
from fsw.kinematics.transforms import Array, Pose, inverse, rotate_back
from fsw.protect.boxes import box_to_box, edges_to_box, point_to_box
from fsw.protect.space import GROUND, OBSTACLES, PARTS, Space

ROUNDING_M: Final = 1e-5
"""What begins too close may come this much closer."""

SPOKEN: Final = {
    "link2": "upper arm",
    "link3": "forearm",
    "link4": "wrist",
    "link5": "turret joint",
    "drt": "DRT",
    "mahli": "MAHLI",
    "apxs": "APXS",
    "portion": "portion tube",
}

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class TooClose:
    """A part of the arm that comes too close to something on a path."""

    part: str
    obstacle: str
    distance_m: float
    """The least on the path; at most 0 where they meet."""
    least_m: float
    """What it was to keep."""
    first: int
    """The first pose that is too close."""

    @property
    def reason(self) -> str:
        """The sentence for a refusal."""
        part, obstacle = _spoken(self.part), _spoken(self.obstacle)
        if self.distance_m <= 0:
            return f"the {part} meets the {obstacle}"
        return (
            f"the {part} comes within {1e3 * self.distance_m:.1f} mm of the {obstacle}, "
            f"at least {1e3 * self.least_m:.1f} mm are to be kept"
        )


def too_close(
    space: Space, frames: Frames, padding_m: float, touching: Tool | None = None
) -> TooClose | None:
    """What comes closer than the padding first along poses (n), or None; a tool that is to touch may.

    What begins closer may stay as it is, or go away: that is the way out.
    """
    apart = clearances(space, frames, padding_m, touching)
    least = np.minimum(padding_m, apart[..., :1] - ROUNDING_M)
    bad = apart < least
    if not bad.any():
        return None
    first = int(bad.any(axis=(0, 1)).argmax())
    short = np.where(bad[..., first], apart[..., first] - least[..., 0], np.inf)
    part, obstacle = np.unravel_index(int(short.argmin()), short.shape)
    return TooClose(
        PARTS[part],
        OBSTACLES[obstacle],
        float(apart[part, obstacle].min()),
        float(least[part, obstacle, 0]),
        first,
    )


def clearances(space: Space, frames: Frames, within_m: float, touching: Tool | None = None) -> Array:
    """How far each part is from each obstacle at poses (n): (PARTS, OBSTACLES, n), inf beyond `within_m`."""
    arm, X_RS = space.arm, placed(space, frames)
    apart = np.full((len(PARTS), len(OBSTACLES), X_RS.p.shape[-1]), np.inf)
    height = _height(space, X_RS)
    low, at = np.nonzero(height < within_m)
    np.minimum.at(apart[:, GROUND], (arm.part[low], at), height[low, at])
    near, hull, at = _neighbours(space, X_RS.p, within_m)
    distance = _distances(space, X_RS[near, at], near, hull)
    np.minimum.at(apart, (arm.part[near], space.rover.part[hull], at), distance)
    if touching is not None:
        apart[PARTS.index(touching.name.lower())] = np.inf
    apart[apart > within_m] = np.inf
    return apart


def placed(space: Space, frames: Frames) -> Pose:
    """The arm's shapes in RMECH at poses (n), batch (m, n)."""
    arm, X_RC = space.arm, _carriers(frames)
    R_RC = X_RC.R[:, :, arm.carrier]
    p_RS = np.einsum("ijmn,jm->imn", R_RC, arm.X_CS.p) + X_RC.p[:, arm.carrier]
    return Pose(np.einsum("ijmn,jkm->ikmn", R_RC, arm.X_CS.R), p_RS)


def _carriers(frames: Frames) -> Pose:
    """Links 1 to 5 and Arm6 in RMECH, batch (6, n)."""
    link, end = frames.X_RL, frames.X_RF
    return Pose(
        np.concatenate([link.R[:, :, 1:], end.R[:, :, 5:]], axis=2),
        np.concatenate([link.p[:, 1:], end.p[:, 5:]], axis=1),
    )


def _height(space: Space, X_RS: Pose) -> Array:
    """Of the lowest point of every solid above level ground, (m, n)."""
    arm = space.arm
    lowest = X_RS.p[2] + np.einsum("kmn,km->mn", np.abs(X_RS.R[2]), arm.half_m) + arm.radius_m[:, None]
    height: Array = space.ground_z_m - lowest
    return height


def _neighbours(space: Space, p_RS: Array, within_m: float) -> tuple[Indices, ...]:
    """Solids of arm and rover that may be so close, and at which pose: by spheres around those of the arm."""
    arm, rover = space.arm, space.rover
    found = []
    for k in range(rover.part.size):
        X_RO = rover.X_CS[k]
        p_O = rotate_back(X_RO.R, p_RS - X_RO.p[:, None, None])
        bound = point_to_box(p_O, rover.half_m[:, k, None, None]) - arm.reach_m[:, None]
        near, at = np.nonzero(bound < within_m + rover.radius_m[k])
        found.append((near, np.full_like(near, k), at))
    near, hull, at = (np.concatenate(column) for column in zip(*found, strict=True))
    return near, hull, at


def _distances(space: Space, X_RS: Pose, near: Indices, hull: Indices) -> Array:
    """The distances (k) of solids of the arm, where they are, to solids of the rover."""
    X_RO, half_S, half_O = space.rover.X_CS[hull], space.arm.half_m[:, near], space.rover.half_m[:, hull]
    X_OS = inverse(X_RO) @ X_RS
    distance = np.empty(near.size)
    line_S, line_O = space.arm.thin[near], space.rover.thin[hull]
    one, other, both = line_S, ~line_S & line_O, ~line_S & ~line_O
    distance[one] = edges_to_box(X_OS[one], half_S[:, one], half_O[:, one], edges=1)
    distance[other] = edges_to_box(inverse(X_OS[other]), half_O[:, other], half_S[:, other], edges=1)
    distance[both] = box_to_box(X_OS[both], half_O[:, both], half_S[:, both])
    return distance - space.arm.radius_m[near] - space.rover.radius_m[hull]


def _spoken(name: str) -> str:
    return SPOKEN.get(name, name.replace("_", " "))
