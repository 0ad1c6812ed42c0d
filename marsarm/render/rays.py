"""Camera that needs no OpenGL: MuJoCo casts a ray for each pixel, numpy shades the surface.

The rays see every opaque geom of groups 0 to 2. A texture is replaced by its mean
colour. Decorations (sites, contacts) and reflections are left out.
"""

import copy
from dataclasses import dataclass
from functools import lru_cache
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
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    return _triangulate_shape(kind, tuple(model.geom_size[geom].tolist()))


@lru_cache(maxsize=1024)
def _triangulate_shape(kind: mujoco.mjtGeom, size_m: tuple[float, float, float]) -> Triangles | None:
    kinds, size = mujoco.mjtGeom, np.array(size_m)
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


Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

TILE_PIXELS = 32
"""Side of a square tile, whose rays are cast together at the few geoms near them."""
SUBPIXELS = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
"""Offsets of the four rays of a pixel on an edge, in pixels from its centre."""
AMBIENT = 0.36
SUN = 0.75
SUN_DISTANCE_M = 1000.0
SHADOW_BIAS_M = 0.002
HAZE_M = 150.0
RAY_LENGTH_M = 1e5
DEFAULT_SKY = (0.80, 0.74, 0.66)
DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
VISIBLE_GROUPS = 3
"""Geoms of groups below this are drawn: MuJoCo's renderer shows these by default."""
VISIBLE = (np.arange(mujoco.mjNGROUP) < VISIBLE_GROUPS).astype(np.uint8)
HIDDEN = 5


class RayCamera:
    """Camera of the model that draws by ray casting."""

    def __init__(self, model: mujoco.MjModel, camera_id: int, size: tuple[int, int]) -> None:
        self._rays = Rays(model)
        self._camera_id = camera_id
        self._size = size
        self._half_height = float(np.tan(np.radians(model.cam_fovy[camera_id]) / 2))
        self._sky = _sky(model)
        self._rgb = np.array([geom_rgb(model, geom) for geom in range(model.ngeom)]).reshape(-1, 3)

    def take(self, data: mujoco.MjData) -> Image:
        """Draw the scene in its current state; shape (height, width, 3), 0 to 255.

        Pixels on edges of shapes and shadows get four rays, the others one.
        """
        width, height = self._size
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        centre = np.column_stack([columns.ravel(), rows.ravel()])
        rgb, face = self._shade(data, centre)
        edge = _edge_pixels(face.reshape(height, width, -1)).ravel()
        finer = (centre[edge, None, :] + SUBPIXELS).reshape(-1, 2)
        rgb[edge] = self._shade(data, finer)[0].reshape(-1, len(SUBPIXELS), 3).mean(axis=1)
        return (255.0 * np.clip(rgb, 0.0, 1.0) + 0.5).astype(np.uint8).reshape(height, width, 3)

    def _shade(self, data: mujoco.MjData, pixel: Floats) -> tuple[Floats, Floats]:
        """Compute colours (n, 3) at image points (n, 2), and geom, normal and sunlight there (n, 5)."""
        rgb, face = np.empty((len(pixel), 3)), np.empty((len(pixel), 5))
        tile = (pixel // TILE_PIXELS) @ [1.0, 1e6]
        order = np.argsort(tile, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(tile[order])) + 1):
            rgb[part], face[part] = self._shade_tile(data, pixel[part])
        return rgb, face

    def _shade_tile(self, data: mujoco.MjData, pixel: Floats) -> tuple[Floats, Floats]:
        eye = data.cam_xpos[self._camera_id]
        direction = self._directions(data, pixel)
        geom, distance, normal = self._rays.cast(data, eye, direction)
        normal = np.where(np.sum(normal * direction, axis=1, keepdims=True) > 0.0, -normal, normal)
        hit = geom >= 0
        shade, is_sunny = self._rays.brightness(data, eye + distance[hit, None] * direction[hit], normal[hit])
        haze = np.exp(-distance[hit, None] / HAZE_M)
        rgb = np.tile(self._sky, (len(pixel), 1))
        rgb[hit] = haze * shade * self._rgb[geom[hit]] + (1.0 - haze) * self._sky
        sunny = np.zeros(len(pixel))
        sunny[hit] = is_sunny
        return rgb, np.column_stack([geom, normal, sunny])

    def _directions(self, data: mujoco.MjData, pixel: Floats) -> Floats:
        """Compute unit vectors (n, 3) in the world through image points, in pixels from the top left."""
        right, down = ((2 * pixel - self._size) * self._half_height / self._size[1]).T
        R_WC = data.cam_xmat[self._camera_id].reshape(3, 3)
        return _unit(np.column_stack([right, -down, np.full(len(pixel), -1.0)]) @ R_WC.T)


class Rays:
    """Ray caster on a copy of the model, in which geoms can be hidden."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.copy(model)
        # Bounding volumes of bodies exclude geoms without contact, so rays would pass through those geoms.
        self._model.body_bvhadr[:] = -1
        self._group = model.geom_group.copy()
        self._tint = model.light_diffuse[0] / max(model.light_diffuse[0].max(), 1e-6) if model.nlight else 1.0

    def cast(
        self, data: mujoco.MjData, origin: Floats, direction: Floats
    ) -> tuple[NDArray[np.int32], Floats, Floats]:
        """Cast rays from one point [m] in world axes along unit vectors, (n, 3).

        Return the first geom hit, -1 for none, (n,), its distance [m], (n,), and its normal, (n, 3).
        """
        count = len(direction)
        geom, distance, normal = np.full(count, -1, np.int32), np.zeros(count), np.zeros((count, 3))
        if count:
            shown = self._geoms_in_cone(data, origin, direction)
            self._model.geom_group[:] = np.where(shown, self._group, HIDDEN)
            rays, normals = direction.ravel(), normal.reshape(-1)
            mujoco.mj_multiRay(
                self._model,
                data,
                origin,
                rays,
                VISIBLE,
                True,
                -1,
                geom,
                distance,
                normals,
                count,
                RAY_LENGTH_M,
            )
        return geom, distance, normal

    def brightness(
        self, data: mujoco.MjData, point: Floats, normal: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Compute the light on surface points: skylight from above, and the sun where nothing casts a shadow.

        Points [m] and unit normals are in world axes, (n, 3). Return factors on red, green and blue, (n, 3),
        and whether the sun shines there, (n,).
        """
        sun = data.light_xdir[0] if self._model.nlight else np.array([0.0, 0.0, -1.0])
        sunlight = np.maximum(0.0, -(normal @ sun))
        facing = sunlight > 0.0
        origin = self._model.stat.center - SUN_DISTANCE_M * sun
        ray = point[facing] - origin
        _, distance, _ = self.cast(data, origin, _unit(ray))
        sunlight[facing] *= distance > np.linalg.norm(ray, axis=1) - SHADOW_BIAS_M
        skylight = AMBIENT + 0.08 * normal[:, 2]
        return np.asarray(skylight[:, None] + SUN * sunlight[:, None] * self._tint), sunlight > 0.0

    def _geoms_in_cone(self, data: mujoco.MjData, origin: Floats, direction: Floats) -> NDArray[np.bool_]:
        """Find geoms (ngeom,) whose bounding sphere intersects the cone around the rays."""
        axis = _unit(direction.mean(axis=0, keepdims=True))[0]
        opening = np.arccos(np.clip(direction @ axis, -1.0, 1.0)).max()
        offset = data.geom_xpos - origin
        distance, radius = np.linalg.norm(offset, axis=1), self._model.geom_rbound
        outside = distance > radius
        off_axis = np.arccos(np.clip(_unit(offset) @ axis, -1.0, 1.0))
        aperture = np.arcsin(np.divide(radius, distance, out=np.ones_like(radius), where=outside))
        unbounded = radius <= 0.0  # planes
        return np.asarray(unbounded | ~outside | (off_axis < opening + aperture + 1e-6))


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-12))


def _edge_pixels(face: Floats) -> NDArray[np.bool_]:
    """Find pixels (height, width) that show another geom, face or edge of a shadow than a neighbour."""
    edge = np.zeros(face.shape[:2], dtype=bool)
    across = np.abs(np.diff(face, axis=1)).max(axis=2) > 0.5
    along = np.abs(np.diff(face, axis=0)).max(axis=2) > 0.5
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= along
    edge[:-1] |= along
    return edge


def geom_rgb(model: mujoco.MjModel, geom: int) -> Floats:
    """Return the colour (3,) of a geom: its own, or its material's if that is the default.

    It is multiplied by the mean colour of the texture.
    """
    rgba, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    if material < 0:
        return np.array(rgba[:3], dtype=np.float64)
    if np.allclose(rgba, DEFAULT_RGBA):
        rgba = model.mat_rgba[material]
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    tint = _mean_colour(model, texture) if texture >= 0 else np.ones(3)
    return np.asarray(rgba[:3] * tint, dtype=np.float64)


def _sky(model: mujoco.MjModel) -> Floats:
    skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    return _mean_colour(model, int(skies[0])) if len(skies) else np.array(DEFAULT_SKY)


def _mean_colour(model: mujoco.MjModel, texture: int) -> Floats:
    channels = int(model.tex_nchannel[texture])
    pixels = int(model.tex_height[texture]) * int(model.tex_width[texture])
    data = model.tex_data[int(model.tex_adr[texture]) :][: pixels * channels]
    mean = data.reshape(pixels, channels).mean(axis=0) / 255.0
    return np.asarray(mean[:3] if channels >= 3 else np.repeat(mean[:1], 3), dtype=np.float64)
