"""Triangles of the geoms of a MuJoCo model, for viewers that have no MuJoCo."""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

FACET_M: Final = 0.025
"""Length of a facet on the circumference of a round geom."""
FEWEST_FACETS, MOST_FACETS = 8, 20
"""Bounds of the facets on a circumference."""
PLANE_M: Final = 150.0
"""Half the side of a plane without limits."""
CUBE_SIDES: Final = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Axes of the sides of a box: the normal, and two along the side that form a right-handed frame with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Triangles whose vertices are shared only where the surface is smooth."""

    vertices_m: NDArray[np.float32]
    """Vertices, shape (n, 3)."""
    faces: NDArray[np.uint32]
    """Indices of the corners, counterclockwise from outside, shape (m, 3)."""


def triangulate(model: mujoco.MjModel, geom: int) -> Triangles | None:
    """Return the triangles of a geom in its own frame, or None for a height field or a distance field."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == kinds.mjGEOM_PLANE:
        x, y = np.where(size[:2] > 0.0, size[:2], PLANE_M)
        return join_triangles([_grid(np.array([[[-x, -y, 0], [-x, y, 0]], [[x, -y, 0], [x, y, 0]]]))])
    if kind == kinds.mjGEOM_BOX:
        return _box(size)
    if kind == kinds.mjGEOM_CYLINDER:
        r, h = size[:2]
        ends = np.array([[0.0, -h], [r, -h], [r, h], [0.0, h]])
        return join_triangles([_revolve(ends[k : k + 2]) for k in range(3)])
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE):
        return join_triangles(
            [_revolve(_half_circle(size[0], size[1] if kind == kinds.mjGEOM_CAPSULE else 0.0))]
        )
    if kind == kinds.mjGEOM_ELLIPSOID:
        round_ = join_triangles([_revolve(_half_circle(float(size.max()), 0.0))])
        return Triangles((round_.vertices_m * (size / size.max())).astype(np.float32), round_.faces)
    return None


def _facets(radius_m: float) -> int:
    return int(np.clip(np.ceil(2 * np.pi * radius_m / FACET_M), FEWEST_FACETS, MOST_FACETS))


def _half_circle(radius_m: float, half_m: float) -> NDArray[np.float64]:
    """Return radius and height, shape (n, 2), of half a circle whose halves are `half_m` off the centre."""
    quarter = np.linspace(0.0, np.pi / 2, _facets(radius_m) // 4 + 1)
    below = np.column_stack([np.sin(quarter), -np.cos(quarter)]) * radius_m - (0.0, half_m)
    return np.vstack([below, (below * (1.0, -1.0))[::-1]])


def _revolve(profile: NDArray[np.float64]) -> Triangles:
    """Revolve a profile of radius and height, shape (n, 2), upward, about z."""
    turn = np.linspace(0.0, 2 * np.pi, _facets(float(profile[:, 0].max())) + 1)
    radius, height = profile.T
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    return _grid(ring[:, None] * radius[:, None] + (height[:, None] * (0.0, 0.0, 1.0)))


def _grid(vertices_m: NDArray[np.float64]) -> Triangles:
    """Return the triangles of a grid of vertices, shape (rows, columns, 3), but none without area."""
    rows, columns = vertices_m.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (index[i : rows - 1 + i, j : columns - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    faces = np.concatenate([np.column_stack([a, c, d]), np.column_stack([a, d, b])])
    corners = vertices_m.reshape(-1, 3)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    has_area = np.linalg.norm(normal, axis=1) > 1e-9 * np.ptp(vertices_m) ** 2
    return Triangles(vertices_m.reshape(-1, 3).astype(np.float32), faces[has_area].astype(np.uint32))


def _box(half_m: NDArray[np.float64]) -> Triangles:
    sides = []
    for normal, u, v in CUBE_SIDES:
        for sign in (-1.0, 1.0):
            corners = np.zeros((2, 2, 3))
            corners[..., normal] = sign * half_m[normal]
            corners[..., u] = half_m[u] * np.array([[-1.0], [1.0]])
            corners[..., v] = half_m[v] * np.array([-1.0, 1.0]) * sign
            sides.append(_grid(corners))
    return join_triangles(sides)


def _mesh(model: mujoco.MjModel, mesh: int) -> Triangles:
    """Return a mesh with flat faces: its edges are sharp."""
    first, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices_m = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
    flat = vertices_m[faces.ravel()].astype(np.float32)
    return Triangles(flat, np.arange(len(flat), dtype=np.uint32).reshape(-1, 3))


def join_triangles(parts: list[Triangles]) -> Triangles:
    """Join triangles into one set."""
    starts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    return Triangles(np.vstack([part.vertices_m for part in parts]), np.vstack(faces).astype(np.uint32))
