"""Distances between rounded boxes: all points within a radius of a box.

A capsule is one whose box has a length only, a sphere one whose box is a point. Batches trail, as everywhere.
"""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose, dot, inverse

_ALONG: Final = np.repeat(np.eye(3), 4, axis=1)
_SIDES: Final = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]).T
_FROM: Final = np.stack(
    [
        np.concatenate([np.full(4, -1.0), _SIDES[0], _SIDES[0]]),
        np.concatenate([_SIDES[0], np.full(4, -1.0), _SIDES[1]]),
        np.concatenate([_SIDES[1], _SIDES[1], np.full(4, -1.0)]),
    ]
)
"""Where the twelve edges of a cube of half size 1 begin; `_ALONG` is where they go, first along x."""


def box_to_box(X_AB: Pose, half_A_m: Array, half_B_m: Array) -> Array:
    """Distance of box A to box B, 0 where they meet, batch (n) of poses and half sizes (3, n).

    The nearest points of two boxes are on an edge of one of them, or a corner, which is the end of one.
    """
    X_BA = inverse(X_AB)
    return np.minimum(edges_to_box(X_AB, half_B_m, half_A_m), edges_to_box(X_BA, half_A_m, half_B_m))


def edges_to_box(X_BE: Pose, half_E_m: Array, half_B_m: Array, edges: int = 12) -> Array:
    """Distance of the edges of box E to box B, batch (n); one edge is all there is of a segment along x."""
    p_EoF_E = _FROM[:, :edges, None] * half_E_m[:, None]
    along_E = 2 * _ALONG[:, :edges, None] * half_E_m[:, None]
    p_B = np.einsum("ijn,jkn->ikn", X_BE.R, p_EoF_E) + X_BE.p[:, None]
    along_B = np.einsum("ijn,jkn->ikn", X_BE.R, along_E)
    nearest: Array = segment_to_box(p_B, along_B, half_B_m[:, None]).min(axis=0)
    return nearest


def segment_to_box(p_m: Array, along_m: Array, half_m: Array) -> Array:
    """Distance of segments from p to p + along to boxes about the origin, (3, ...) each.

    The squared distance of the point at t is convex in t, and its slope is straight between the places where
    the segment passes a face's plane. The slope's root lies between two of them that are next to each other.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        passes = np.concatenate([(half_m - p_m) / along_m, (-half_m - p_m) / along_m])
    bends = np.clip(np.nan_to_num(passes, nan=0.0), 0.0, 1.0)
    bends = np.concatenate([bends, np.zeros((1, *bends.shape[1:])), np.ones((1, *bends.shape[1:]))])
    slope = sum(along_m[k] * _outside(p_m[k] + bends * along_m[k], half_m[k]) for k in range(3))
    before = np.where(slope <= 0, bends, 0.0).max(axis=0)
    after = np.where(slope > 0, bends, 1.0).min(axis=0)
    fall, rise = (dot(along_m, _outside(p_m + t * along_m, half_m)) for t in (before, after))
    share = np.divide(-fall, rise - fall, out=np.zeros_like(rise), where=rise > fall)
    t = before + np.clip(share, 0.0, 1.0) * (after - before)
    apart = _outside(p_m + t * along_m, half_m)
    distance: Array = np.sqrt(dot(apart, apart))
    return distance


def point_to_box(p_m: Array, half_m: Array) -> Array:
    """Distance of points (3, ...) in the axes of a box about the origin; 0 inside."""
    apart = _outside(p_m, half_m)
    distance: Array = np.sqrt(dot(apart, apart))
    return distance


def _outside(x_m: Array, half_m: Array) -> Array:
    """What is left of coordinates beyond a box."""
    left: Array = x_m - np.minimum(np.maximum(x_m, -half_m), half_m)
    return left
