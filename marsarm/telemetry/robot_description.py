"""Scene of a run as it is drawn, by frame of the log, and its URDF, from which viewers draw the arm.

Viewers of a log have boxes, cylinders and spheres without a mesh file, so a geom becomes these.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from fsw.kinematics.transforms import IDENTITY, Array, Pose, inverse
from marsarm.render.rays import VISIBLE_GROUPS, geom_rgb
from sim.arm_model.load import ArmModel
from sim.arm_model.mjcf import HULL
from sim.frames import FLIP, P_NR_M
from sim.setting import World
from sim.world import TURRET, build

DIGITS: Final = 9
"""Decimal places of metres and radians."""


ROBOT_NAME: Final = "marsarm"
"""Name of the robot, under which Rerun lists the shapes."""
ROOT_FRAME: Final = "map"
"""Root frame: RMECH turned so that z is up, as 3D panels expect."""
ROVER_FRAME: Final = "rover"
"""Frame of the rover, RMECH."""
TURRET_FRAME: Final = "arm6"


class Visual(NamedTuple):
    """Shape that a viewer draws in a frame; a cylinder lies along z."""

    shape: str
    """`box`, `cylinder` or `sphere`."""
    size_m: tuple[float, ...]
    """Three sides; radius and length; radius."""
    X: Pose
    """Pose in the frame."""
    rgba: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnScene:
    """Visible shapes by frame, and the frames that stand still beside the arm, in the root frame."""

    visuals: Mapping[str, tuple[Visual, ...]]
    frames: Mapping[str, Pose]


class FixedFrame(NamedTuple):
    """Frame that does not move in its parent."""

    parent: str
    child: str
    X: Pose


class TurningFrame(NamedTuple):
    """Frame that a joint turns about z of its parent."""

    joint: str
    parent: str
    child: str
    zero_rad: float
    """Turn of the frame at zero angle of the joint."""
    min_rad: float
    max_rad: float
    speed_rad_s: float
    torque_Nm: float

    def at(self, angle_rad: float) -> tuple[float, ...]:
        """Return position and quaternion x, y, z, w in the parent at an angle of the joint."""
        half_rad = 0.5 * (self.zero_rad + angle_rad)
        return 0.0, 0.0, 0.0, 0.0, 0.0, math.sin(half_rad), math.cos(half_rad)


def robot_description(
    fixed: Sequence[FixedFrame], turning: Sequence[TurningFrame], visuals: Mapping[str, Sequence[Visual]]
) -> str:
    """Return the URDF of the frames of a log, which together are a tree, and of the shapes in them."""
    robot = Element("robot", name=ROBOT_NAME)
    colours = list(dict.fromkeys(_numbers(one.rgba) for shapes in visuals.values() for one in shapes))
    for k, rgba in enumerate(colours):
        SubElement(SubElement(robot, "material", name=f"colour{k}"), "color", rgba=rgba)
    ends = [(still.parent, still.child) for still in fixed] + [(one.parent, one.child) for one in turning]
    for frame in dict.fromkeys(name for pair in ends for name in pair):
        link = SubElement(robot, "link", name=frame)
        for visual in visuals.get(frame, ()):
            _add_visual(link, visual, f"colour{colours.index(_numbers(visual.rgba))}")
    for still in fixed:
        joint = SubElement(robot, "joint", name=f"{still.parent}_{still.child}", type="fixed")
        _add_origin(joint, still.X.p, _roll_pitch_yaw(still.X.R))
        _add_ends(joint, still.parent, still.child)
    for one in turning:
        joint = SubElement(robot, "joint", name=one.joint, type="revolute")
        _add_origin(joint, (0.0, 0.0, 0.0), (0.0, 0.0, one.zero_rad))
        _add_ends(joint, one.parent, one.child)
        SubElement(joint, "axis", xyz="0 0 1")
        bounds = {"lower": one.min_rad, "upper": one.max_rad}
        rates = {"effort": one.torque_Nm, "velocity": one.speed_rad_s}
        SubElement(joint, "limit", {key: _numbers((value,)) for key, value in (bounds | rates).items()})
    indent(robot, "")
    return tostring(robot, encoding="unicode")


def _add_visual(link: Element, one: Visual, colour: str) -> None:
    visual = SubElement(link, "visual")
    _add_origin(visual, one.X.p, _roll_pitch_yaw(one.X.R))
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}[one.shape]
    values = [one.size_m] if len(keys) == 1 else [(size,) for size in one.size_m]
    sizes = {key: _numbers(value) for key, value in zip(keys, values, strict=True)}
    SubElement(SubElement(visual, "geometry"), one.shape, sizes)
    SubElement(visual, "material", name=colour)


def _add_origin(part: Element, p_m: Iterable[float], rpy_rad: Iterable[float]) -> None:
    SubElement(part, "origin", xyz=_numbers(p_m), rpy=_numbers(rpy_rad))


def _add_ends(joint: Element, parent: str, child: str) -> None:
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _numbers(values: Iterable[float]) -> str:
    """Write numbers without noise in the last bits, which would differ between machines."""
    return " ".join(repr(round(float(value), DIGITS) + 0.0) for value in values)


def _roll_pitch_yaw(R: Array) -> Iterable[float]:
    """Convert a rotation matrix, (3, 3), to turns about fixed x, then y, then z [rad]."""
    angles: Array = Rotation.from_matrix(R).as_euler("xyz", suppress_warnings=True)
    return angles


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
    """Yield the shapes that draw a geom; other shapes than these are drawn as the box around them.

    A mesh is drawn as a box inside: that of a boulder leaves the face free that the arm touches.
    """
    a, b, c = model.geom_size[geom].tolist()
    rgba = tuple(round(x, 3) for x in (*geom_rgb(model, geom).tolist(), _opacity(model, geom)))
    match kind := mujoco.mjtGeom(model.geom_type[geom]):
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
            inside = 1 / np.sqrt(3.0) if kind == mujoco.mjtGeom.mjGEOM_MESH else 1.0
            size_m = tuple((2 * inside * half).tolist())
            yield Visual("box", size_m, X @ Pose(IDENTITY.R, centre.copy()), rgba)


def _opacity(model: mujoco.MjModel, geom: int) -> float:
    material = int(model.geom_matid[geom])
    return float(min(model.geom_rgba[geom, 3], 1.0 if material < 0 else model.mat_rgba[material, 3]))
