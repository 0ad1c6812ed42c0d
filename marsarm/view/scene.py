"""Scene of a view: the triangles of rover, ground, rock and arm, and what each rides on.

The bodies of the arm ride on the frames of the kinematic chain. Their poses on these frames are those of the
drawing, so one function of the chain draws the true arm and the arm that flight software believes.
"""

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.chain import Frames, forward
from fsw.kinematics.transforms import Array, Pose, inverse, stack_poses
from marsarm.render.rays import VISIBLE_GROUPS, Triangles, geom_rgb, join_triangles, triangulate
from marsarm.render.rover_scene import tilt_rover
from sim.arm_model.load import ArmModel
from sim.plant import rotation_matrices
from sim.setting import World
from sim.world import TURRET, build

SPEEDS: Final = (1, 2, 5, 10, 20, 50)
FIRST_SPEED: Final = 10
GHOST_RGB: Final = (40, 115, 240)
FORCE_RGB: Final = (230, 30, 25)
TRAIL_RGB: Final = (255, 217, 25)
CURVE_COLOURS: Final = ("#1d4fa0", "#cf5a00", "#0b9a74", "#c2559d", "#111111")
DARK_CURVE_COLOURS: Final = ("#4a8fff", "#ff9d2e", "#2fc99a", "#f7a6d8", "#ffffff")
"""Colours of the curves on a dark page."""
ARROW_M_PER_N: Final = 0.006
SHORTEST_ARROW_M, LONGEST_ARROW_M = 0.1, 0.8
"""A touch is as long as a tool, and 117 N or more as long as a link: both stay visible."""
ARROW_RADIUS_M, ARROW_HEAD_M = 0.006, 0.02
"""Radius of the shaft and of the head."""
LEAST_FORCE_N: Final = 0.05
"""Force below which no arrow is drawn: the readout shows tenths of a newton."""
TRAIL_STEP_M: Final = 0.01
"""Least distance of two points of a trail: two pixels of the first view, in which a pixel is 5 mm."""
MOST_MAGNIFICATION: Final = 50.0
"""At this factor the 15 mm of an as-built arm are 0.75 m, a third of its reach, and 1 mrad is 3 deg."""


def looks_json() -> dict[str, Any]:
    """Return the numbers and colours as a JSON document for the page; colours of the scene are 0 to 1."""
    scene = {"ghost": GHOST_RGB, "force": FORCE_RGB, "trail": TRAIL_RGB}
    return {
        "speeds": SPEEDS,
        "first_speed": FIRST_SPEED,
        "rgb": {name: [round(value / 255, 3) for value in rgb] for name, rgb in scene.items()},
        "curves": {"light": CURVE_COLOURS, "dark": DARK_CURVE_COLOURS},
        "arrow": {
            "m_per_N": ARROW_M_PER_N,
            "shortest_m": SHORTEST_ARROW_M,
            "longest_m": LONGEST_ARROW_M,
            "radius_m": ARROW_RADIUS_M,
            "head_m": ARROW_HEAD_M,
            "least_N": LEAST_FORCE_N,
        },
        "trail_step_m": TRAIL_STEP_M,
        "magnification": MOST_MAGNIFICATION,
    }


ARM_ROOT: Final = "rmech"
"""Body of the rover frame, which carries the arm."""
STATIC: Final = -1
"""Carrier of what does not move."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Triangles of one colour on one carrier."""

    carrier: int
    """Index of the carrier, or STATIC for a part in world axes."""
    is_ground: bool
    rgb: tuple[float, float, float]
    triangles: Triangles


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Parts of a scene, and the carriers of the arm in its chain."""

    parts: tuple[Part, ...]
    carriers: tuple[str, ...]
    """Names of the bodies that carry the moving parts, from the rover outward."""
    link: NDArray[np.intp]
    """Link of each carrier, shape (b,)."""
    is_far: NDArray[np.bool_]
    """True for carriers beyond the spring of their link, shape (b,)."""
    X_LB: Pose
    """Carriers on their links, batch (b,)."""
    X_WR: Pose
    """Rover frame in world axes, z up."""

    def carrier_poses(self, frames: Frames) -> Pose:
        """Compute the poses of the carriers in world axes, batch (b, n), from frames of batch (6, n)."""
        near, far = frames.X_RL, frames.X_RL @ frames.X_LD
        R, p = (
            np.where(
                self.is_far[:, None],
                getattr(far, name)[..., self.link, :],
                getattr(near, name)[..., self.link, :],
            )
            for name in ("R", "p")
        )
        X_WR = Pose(self.X_WR.R[:, :, None, None], self.X_WR.p[:, None, None])
        return X_WR @ (Pose(R, p) @ Pose(self.X_LB.R[..., None], self.X_LB.p[..., None]))


def build_scene(world: World, drawing: ArmModel, has_turret: bool = True) -> Scene:
    """Build the scene of a world with an arm, or one whose turret is another mass; gravity points down."""
    spec = build(world, drawing, for_pictures=True)
    if not has_turret:
        for geom in spec.body(TURRET).find_all(mujoco.mjtObj.mjOBJ_GEOM):
            geom.group = VISIBLE_GROUPS
    tilt_rover(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = model.body(ARM_ROOT).id
    X_WR = _body_pose(data, root)
    bodies = [body for body in range(model.nbody) if _rides_on_arm(model, body)]
    links = [_link_of(model.body(body).name) for body in bodies]
    arm = build_arm(drawing.params)
    X_LB = stack_poses(
        [
            inverse(_link_pose(arm, link, is_far)) @ (inverse(X_WR) @ _body_pose(data, body))
            for body, (link, is_far) in zip(bodies, links, strict=True)
        ]
    )
    return Scene(
        parts=tuple(_parts(model, data, bodies)),
        carriers=tuple(model.body(body).name for body in bodies),
        link=np.array([link for link, _ in links]),
        is_far=np.array([is_far for _, is_far in links]),
        X_LB=X_LB,
        X_WR=X_WR,
    )


def _rides_on_arm(model: mujoco.MjModel, body: int) -> bool:
    """Return whether a body has joints and carries a visible geom, itself or by bodies welded to it."""
    if model.body_weldid[body] != body or body == 0:
        return False
    return any(model.body_weldid[owner] == body for owner in model.geom_bodyid)


def _link_of(body: str) -> tuple[int, bool]:
    """Return link and side of the spring of a body: `arm1`, `link2` or `link2_far`."""
    if body == "arm1":
        return 0, True
    name, _, side = body.removeprefix("link").partition("_")
    return int(name), side == "far"


def _link_pose(arm: Arm, link: int, is_far: bool) -> Pose:
    frames = forward(arm, np.zeros(5))
    near = frames.X_RL[link]
    return near @ frames.X_LD[link] if is_far else near


def _body_pose(data: mujoco.MjData, body: int) -> Pose:
    return Pose(rotation_matrices(data.xquat[body : body + 1])[:, :, 0], data.xpos[body].copy())


def _parts(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]) -> list[Part]:
    """Collect the visible triangles by carrier and colour."""
    found: dict[tuple[int, bool, tuple[float, ...]], list[Triangles]] = defaultdict(list)
    sand = model.geom("ground").matid[0]
    for geom in range(model.ngeom):
        triangles = triangulate(model, geom) if model.geom_group[geom] < VISIBLE_GROUPS else None
        if triangles is None:
            continue
        weld = int(model.body_weldid[model.geom_bodyid[geom]])
        R_WG, p_W_m = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        vertices_m: Array = triangles.vertices_m @ R_WG.T + p_W_m
        carrier = bodies.index(weld) if weld in bodies else STATIC
        if carrier != STATIC:
            X_WB = _body_pose(data, weld)
            vertices_m = (vertices_m - X_WB.p) @ X_WB.R
        rgb = tuple(round(float(value), 3) for value in geom_rgb(model, geom))
        is_ground = bool(model.geom_matid[geom] == sand)
        found[carrier, is_ground, rgb].append(Triangles(vertices_m.astype(np.float32), triangles.faces))
    return [
        Part(carrier, is_ground, (r, g, b), join_triangles(parts))
        for (carrier, is_ground, (r, g, b)), parts in found.items()
    ]
