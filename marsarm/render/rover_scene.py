"""Scene of the rover before it is drawn: tilted, with a level horizon; and outlines of collision shapes."""

from collections.abc import Iterator
from itertools import product
from typing import Any, Final

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from fsw.collision.geometry import RoundedBoxes
from fsw.kinematics.transforms import Array, Pose

CENTRE_M: Final = np.array([0.5, 0.0, 0.0])
"""Centre of the slope, in world axes from the rover's origin; rover and workspace are around it."""
RADIUS_M: Final = 2.3
"""Radius of the slope, larger than the distance to the rear wheels and the reach of the arm."""


def tilt_rover(spec: mujoco.MjSpec) -> None:
    """Rotate rover, arm and rock until gravity points down, on a slope whose lower edge lies in the plain.

    Plain, scenery, sky, light, cameras and horizon stay level. A level rover is not changed.
    """
    gravity = spec.option.gravity.copy()
    if not gravity[:2].any():
        return
    g_m_s2 = float(np.linalg.norm(gravity))
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, -gravity / g_m_s2)
    mujoco.mju_negQuat(quat, quat)
    spec.option.gravity = (0.0, 0.0, -g_m_s2)
    ground, scenery = spec.geom("ground"), spec.body("mars_scenery")
    centre = CENTRE_M + ground.pos
    frame = spec.worldbody.add_frame(pos=centre - _rotate(quat, centre), quat=quat)
    if spec.camera("target") is not None:
        rock = spec.body("rock").pos
        spec.camera("target").pos += frame.pos + _rotate(quat, rock) - rock
    for element in (*spec.worldbody.bodies, *spec.worldbody.geoms):
        if element not in (ground, scenery):
            element.set_frame(frame)
    drop_m = RADIUS_M * float(np.linalg.norm(gravity[:2])) / g_m_s2
    for element in (ground, scenery):
        if element is not None:
            element.pos[2] -= drop_m
    spec.worldbody.add_geom(
        name="slope",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=centre - (0.0, 0.0, 2.0 * drop_m),
        size=(RADIUS_M, 2.0 * drop_m, 0.0),
        contype=0,
        conaffinity=0,
        group=2,
        material=ground.material,
    ).set_frame(frame)


def _rotate(quat: Array, v: Array) -> Array:
    rotated = np.zeros(3)
    mujoco.mju_rotVecQuat(rotated, v, quat)
    return rotated


def project_outlines(boxes: RoundedBoxes, X_RS: Pose, axes: tuple[int, int]) -> Iterator[Array]:
    """Yield the outline of each shape, seen along the axis that is not among these of the rover frame.

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
