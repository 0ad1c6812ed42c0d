"""Changes of the scene before it is drawn: a tilted rover, or the collision shapes of flight software."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from fsw.collision.distance import place_shapes
from fsw.collision.geometry import RoundedBoxes
from fsw.config import configure
from fsw.dictionary.params import Params
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose
from marsarm.render.picture import PictureResult, save_picture
from sim.arm_model.load import ArmModel
from sim.frames import FLIP, P_NR_M
from sim.plant import Plant
from sim.world import World, build

CENTRE_M: Final = np.array([0.5, 0.0, 0.0])
"""Centre of the slope, in world axes from the rover's origin; rover and workspace are around it."""
RADIUS_M: Final = 2.3
"""Radius of the slope, larger than the distance to the rear wheels and the reach of the arm."""
ARM_RGBA: Final = (0.10, 0.45, 0.95, 0.45)
ROVER_RGBA: Final = (1.0, 0.45, 0.05, 0.30)


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


def save_collision_picture(
    params: Params,
    output_rad: Array,
    path: Path,
    camera: str = "workspace",
    size: tuple[int, int] = (1280, 720),
    arm: ArmModel | None = None,
) -> PictureResult:
    """Save a picture of the arm, deflected by gravity on Mars, with the collision shapes of arm and rover.

    Args:
        output_rad: Output angles, shape (5,).
        arm: Drawing of the arm; None for the default one.

    Raises:
        PictureError: the path cannot be written or there is no such camera.
    """
    config, world = configure(params), World()
    equilibrium = settle_output(config.arm, output_rad[:, None], world.gravity_N_m_s2)
    spec = build(world, arm, for_pictures=True)
    shapes = config.collision_geometry
    _add_shapes(spec, shapes.arm, place_shapes(shapes, equilibrium.frames)[:, 0], ARM_RGBA)
    _add_shapes(spec, shapes.rover, shapes.rover.X_CS, ROVER_RGBA)
    plant = Plant(spec.compile())
    plant.show(output_rad, equilibrium.strain[:, :, 0])
    mujoco.mj_forward(plant.model, plant.data)
    return save_picture(plant.model, plant.data, camera, path, size)


def _add_shapes(spec: mujoco.MjSpec, solids: RoundedBoxes, X_RS: Pose, rgba: tuple[float, ...]) -> None:
    """Add solids as geoms without contact; the axis of a capsule is z in MuJoCo and x here."""
    for k in range(solids.part.size):
        R_WS, half, radius = FLIP[:, None] * X_RS.R[:, :, k], solids.half_m[:, k], solids.radius_m[k]
        if solids.is_capsule[k]:
            kind, sizes = mujoco.mjtGeom.mjGEOM_CAPSULE, (radius, max(half[0], 1e-6), 0.0)
            R_WS = R_WS[:, [1, 2, 0]]
        else:
            kind, sizes = mujoco.mjtGeom.mjGEOM_BOX, tuple(half)
        geom = spec.worldbody.add_geom(type=kind, size=sizes, rgba=rgba, contype=0, conaffinity=0)
        geom.pos = FLIP * (X_RS.p[:, k] + P_NR_M)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R_WS).ravel())
        geom.quat = quaternion


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
