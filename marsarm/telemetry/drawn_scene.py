"""Scene of a run as it is drawn: the visible geoms of arm, rover, rock and ground, by frame of the log.

Viewers of a log have boxes, cylinders and spheres without a mesh file, so a geom becomes these.
"""

from collections import defaultdict
from collections.abc import Iterator
from typing import Final

import mujoco
import numpy as np

from fsw.kinematics.transforms import IDENTITY, Array, Pose, inverse
from marsarm.render.rays import VISIBLE_GROUPS, geom_rgb
from marsarm.telemetry.robot_description import ROVER_FRAME, TURRET_FRAME, DrawnScene, Visual
from sim.arm_model.load import ArmModel
from sim.arm_model.mjcf import HULL
from sim.frames import FLIP, P_NR_M
from sim.world import TURRET, World, build

GROUND_FRAME: Final = "ground"
"""Frame of ground and terrace: MuJoCo's world, on the ground below the rover."""
ROCK_FRAME: Final = "rock"
"""Frame of the rock: origin in its face, z out of it."""
ROVER_BODY: Final = "rover"
"""Body of the rover, with frame RNAV; the rover frame of a log is RMECH, that of the body `rmech`."""
FRAME_OF_BODY: Final = {"world": GROUND_FRAME, "rmech": ROVER_FRAME, TURRET: TURRET_FRAME}
"""Frames that have another name than the body at the same place."""
SCENERY_BODY: Final = "mars_scenery"
"""Decoration far from the arm, which is left out."""
FAR_SIDE: Final = "_far"
"""End of the name of a body beyond the spring of a link; in the log, links are rigid."""
GROUND_HALF_M: Final = 5.0
"""Half side of the drawn part of the ground, larger than rover and reach of the arm."""
GROUND_DEPTH_M: Final = 0.01


def draw_scene(world: World, arm: ArmModel | None) -> DrawnScene:
    """Return the scene of a world with the drawing of an arm, None for the default one.

    An arm that differs from its drawing has the same shapes; its frames are those of flight software.
    """
    model = build(world, arm, for_pictures=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # at rest no spring is bent, so the two bodies of a link are one
    visuals: dict[str, list[Visual]] = defaultdict(list)
    for geom in range(model.ngeom):
        body = _carrier(model, int(model.geom_bodyid[geom]))
        if body is None or model.geom_group[geom] >= VISIBLE_GROUPS:
            continue
        name = model.body(body).name
        X_BG = inverse(_pose(data.xpos[body], data.xmat[body])) @ _pose(
            data.geom_xpos[geom], data.geom_xmat[geom]
        )
        visuals[FRAME_OF_BODY.get(name, name)] += visuals_of(model, geom, X_BG)
    # the root frame has the axes of MuJoCo's world, and the origin of RMECH
    frames = {
        FRAME_OF_BODY.get(name, name): Pose(
            data.body(name).xmat.reshape(3, 3).copy(), data.body(name).xpos - FLIP * P_NR_M
        )
        for name in ("world", ROCK_FRAME)
        if name == "world" or world.surface is not None
    }
    return DrawnScene({frame: tuple(shapes) for frame, shapes in visuals.items()}, frames)


def _carrier(model: mujoco.MjModel, body: int) -> int | None:
    """Return the body whose frame the log has and that carries a body; None for decoration."""
    name = model.body(body).name
    if name == SCENERY_BODY:
        return None
    if name in (ROVER_BODY, HULL):
        return int(model.body("rmech").id)
    parent = int(model.body_parentid[body])
    is_part = name.endswith(FAR_SIDE)
    return _carrier(model, parent) if is_part else body


def _pose(p_m: Array, R: Array) -> Pose:
    return Pose(R.reshape(3, 3).copy(), p_m.copy())


def visuals_of(model: mujoco.MjModel, geom: int, X: Pose) -> Iterator[Visual]:
    """Yield the shapes that draw a geom; other shapes than these are drawn as the box around them."""
    a, b, c = model.geom_size[geom].tolist()
    rgba = tuple(round(x, 3) for x in (*geom_rgb(model, geom).tolist(), _opacity(model, geom)))
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_PLANE:
            below = Pose(np.eye(3), np.array([0.0, 0.0, -0.5 * GROUND_DEPTH_M]))
            side = 2 * GROUND_HALF_M
            yield Visual("box", (side, side, GROUND_DEPTH_M), X @ below, rgba)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            yield Visual("sphere", (a,), X, rgba)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            yield Visual("cylinder", (a, 2 * b), X, rgba)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            yield Visual("cylinder", (a, 2 * b), X, rgba)
            for end in (-b, b):
                yield Visual("sphere", (a,), X @ Pose(np.eye(3), np.array([0.0, 0.0, end])), rgba)
        case mujoco.mjtGeom.mjGEOM_BOX:
            yield Visual("box", (2 * a, 2 * b, 2 * c), X, rgba)
        case _:
            centre, half = model.geom_aabb[geom].reshape(2, 3)
            yield Visual("box", tuple((2 * half).tolist()), X @ Pose(IDENTITY.R, centre.copy()), rgba)


def _opacity(model: mujoco.MjModel, geom: int) -> float:
    material = int(model.geom_matid[geom])
    return float(min(model.geom_rgba[geom, 3], 1.0 if material < 0 else model.mat_rgba[material, 3]))
