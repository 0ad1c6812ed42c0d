"""Outlines of collision shapes in a plane, for figures of arm and rover."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from fsw.collision.geometry import RoundedBoxes
from fsw.kinematics.transforms import Array, Pose


def project_outlines(boxes: RoundedBoxes, X_RS: Pose, axes: tuple[int, int]) -> Iterator[Array]:
    """Yield the outline of each shape, seen along the third axis.

    Args:
        boxes: Shapes.
        X_RS: Their poses in the rover frame, batch (m).
        axes: Axes of the plane, 0 to 2 for x, y, z of the rover frame.

    Yields:
        Corners [m] of a convex polygon, shape (n, 2).
    """
    signs = np.array(list(product((-1.0, 1.0), repeat=3))).T
    for k in range(boxes.part.size):
        # a box as large as the rounded one: its corners are outside of the shape by less than its radius
        corners = signs * (boxes.half_m[:, k] + boxes.radius_m[k])[:, None]
        flat = (X_RS.R[:, :, k] @ corners + X_RS.p[:, k, None])[list(axes)].T
        yield flat[ConvexHull(flat).vertices]


def draw_outlines(axes: Any, outlines: Iterator[Array], shift_m: Array | float = 0.0, **style: Any) -> None:
    """Draw outlines as filled polygons, shifted by an offset [m], shape (2,)."""
    from matplotlib.patches import Polygon

    for outline in outlines:
        axes.add_patch(Polygon(outline + shift_m, closed=True, **style))
