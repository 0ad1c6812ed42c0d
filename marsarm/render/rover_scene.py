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
FOOT_M: Final = 4 * RADIUS_M
"""Radius of the hill that has the slope on top: on its highest side it is at most as steep as the slope."""
SECTORS: Final = 96
GRAIN_1_M: Final = 0.125
"""Copies of the texture in a metre, as on the plain."""


def tilt_rover(spec: mujoco.MjSpec) -> None:
    """Rotate rover, arm and rock until gravity points down, on a hill that runs out into the plain.

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
    hill = _Hill(centre, gravity)
    for element in (ground, scenery):
        if element is not None:
            element.pos[2] -= hill.drop_m
    for rock in () if scenery is None else scenery.geoms:
        if rock.type == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            rock.pos[2] += float(hill.height_m(rock.pos[:2]))
    vertices, faces = hill.surface()
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.add_mesh(
        name="slope",
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        usertexcoord=(GRAIN_1_M * vertices[:, :2]).ravel(),
        inertia=shell,
    )
    spec.worldbody.add_geom(
        name="slope",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="slope",
        pos=(*centre[:2], centre[2] - hill.drop_m),
        contype=0,
        conaffinity=0,
        group=2,
        material=ground.material,
    )


class _Hill:
    """Hill: a slope around a centre, whose lowest point is on the plain, and sides that run out into it."""

    def __init__(self, centre_m: Array, gravity: Array) -> None:
        """Take the centre of the slope, shape (3,), and gravity in world axes turned with the rover."""
        self._centre_m = centre_m
        self._rise = gravity[:2] / gravity[2]
        self.drop_m = RADIUS_M * float(np.linalg.norm(self._rise))

    def height_m(self, p_m: Array) -> Array:
        """Return the height over the plain of points in world axes, shape (..., 2)."""
        away = p_m - self._centre_m[:2]
        r = np.linalg.norm(away, axis=-1)
        inside = away * np.minimum(1.0, RADIUS_M / np.maximum(r, 1e-9))[..., None]
        share = np.clip((FOOT_M - r) / (FOOT_M - RADIUS_M), 0.0, 1.0)
        return np.asarray((self.drop_m + inside @ self._rise) * share**2 * (3.0 - 2.0 * share))

    def surface(self) -> tuple[Array, Array]:
        """Return vertices from the centre's foot on the plain, shape (n, 3), and faces, shape (m, 3)."""
        radius = np.append(0.0, np.linspace(RADIUS_M, FOOT_M, 16))
        turn = np.arange(SECTORS) * 2 * np.pi / SECTORS
        flat = radius[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        vertices = np.dstack([flat, self.height_m(self._centre_m[:2] + flat)]).reshape(-1, 3)
        index = np.arange(len(vertices)).reshape(-1, SECTORS)
        a, b = index[:-1], index[1:]
        c, d = (np.roll(rows, -1, axis=1) for rows in (b, a))
        faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)[1:]])
        return vertices, faces.reshape(-1, 3)


def _rotate(quat: Array, v: Array) -> Array:
    rotated = np.zeros(3)
    mujoco.mju_rotVecQuat(rotated, v, quat)
    return rotated


def project_outlines(boxes: RoundedBoxes, X_RS: Pose, axes: tuple[int, int]) -> Iterator[Array]:
    """Yield the convex outline, (n, 2) [m], of each shape along the axis of the rover that is not given."""
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
