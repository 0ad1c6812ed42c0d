"""World around the arm: the scene, the tilt of the rover, the rock face to touch, and the drawing of the arm.

MuJoCo has no field for thermal expansion. `attach_drawing` puts it into the comment of the specification,
which the compiler leaves out of the model. The boulder is looks only: the contact is a disc in its face.
"""

import json
import re
from dataclasses import replace
from functools import cache
from typing import Final

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params
from fsw.dictionary.types import Row6, Vector3, row6
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array, Pose, screw_exp
from sim.arm_model.description import BadArm
from sim.arm_model.load import SCENES, ArmModel, default_arm
from sim.arm_model.mjcf import HULL
from sim.frames import FLIP, P_NR_M
from sim.record import LINK_BODIES
from sim.setting import BELOW_ROCK_M, Scene, World

RINGS: Final = 28
SECTORS: Final = 56
"""At 0.2 m from the centre, a triangle is 2 cm wide: chips and edges show in pictures 1,300 pixels wide."""
CHIPS: Final = 40
"""Number of planes; with fewer the boulder looks cut, with many more it is an egg."""
DEPTH: Final = (0.80, 1.0)
"""Distances of the planes from the centre, as shares of the radius."""
ROUGHNESS: Final = 0.02
SEED: Final = 6


def boulder(half_m: Array, face_m: Array, normal: Array) -> tuple[Array, Array]:
    """Return vertices (n, 3) and faces (m, 3) of a boulder around the origin, an ellipsoid of half axes (3,).

    A face cuts it at a point (3,), with the unit vector out of it, (3,); the origin is behind the face.
    """
    polar = np.linspace(0.0, np.pi, RINGS + 1)
    turn = np.arange(SECTORS) * 2 * np.pi / SECTORS
    x, y = (np.outer(np.sin(polar), f(turn)) for f in (np.cos, np.sin))
    unit = np.stack([x, y, np.broadcast_to(np.cos(polar)[:, None], x.shape)], axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(SEED)
    planes = rng.normal(size=(CHIPS, 3))
    planes /= np.linalg.norm(planes, axis=1)[:, None] * rng.uniform(*DEPTH, (CHIPS, 1))
    nearest = np.maximum(unit @ planes.T, 0.0).max(axis=1)
    rough = 1.0 + ROUGHNESS * rng.uniform(-1.0, 1.0, (RINGS + 1, SECTORS))
    rough[[0, -1]] = 1.0  # the poles are one point each
    along = unit * half_m * (rough.ravel() / np.maximum(nearest, 1.0))[:, None]
    beyond = (along @ normal) / float(face_m @ normal)
    return along / np.maximum(beyond, 1.0)[:, None], _faces()


def _faces() -> Array:
    index = np.arange((RINGS + 1) * SECTORS).reshape(RINGS + 1, SECTORS)
    a, b = index[:-1], index[1:]
    c, d = (np.roll(rows, -1, axis=1) for rows in (b, a))
    upper, lower = np.stack([a, b, c], axis=-1)[:-1], np.stack([a, c, d], axis=-1)[1:]
    return np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])


ARM_FILE: Final = "arm.xml"
ROVER_FILE: Final = "rover.xml"
NO_LOOKS: Final = b"<mujoco><worldbody><body name='rover' quat='0 1 0 0'/></worldbody></mujoco>"
"""Takes the place of the looks of Curiosity for an arm on another rover."""
INCLUDED_ARM: Final = re.compile(r'(?<=<include file=")[^"]*/arm\.xml')
"""Arm that a scene includes, so that it opens by itself; another arm may take its place."""
REQUIRED_MUJOCO: Final = "4.0.1"
ROCK_RADIUS_M: Final = 0.1
ROCK_HALF_DEPTH_M: Final = 0.04
ROCK_HEIGHT_M: Final = 0.45
ELBOW_ABOVE_M: Final = 0.9
"""Height above the shoulder that a picture keeps for the elbow."""
FIELD_OF_VIEW_DEG: Final = 38.0
PICTURE_ASPECT: Final = 16 / 9
PICTURE_SHARE: Final = 0.94
"""Share of the picture, from its centre, in which the camera `target` keeps what it shows."""
MAST_TOP_N_M: Final = np.array([0.78, 0.56, -2.16])
"""Top of the mast in models/mjcf/rover.xml."""
BOULDER_HALF_M: Final = (0.28, 0.24)
"""Half axes of the boulder; the arm needs 0.1 m around the point that it touches."""
BEHIND_FACE_M: Final = 0.002
"""Distance of the boulder's face behind the disc that is touched, so that the disc is seen."""
CAMERA_SIDE: Final = np.array([0.9, -1.0, 0.2])
"""Direction from the arm to the camera `target`, world axes."""


class WrongMujoco(RuntimeError):
    """MuJoCo version other than the required one; only one version gives identical bits."""


def build(world: World, arm: ArmModel | None = None, for_pictures: bool = False) -> mujoco.MjSpec:
    """Make the MuJoCo specification of this world with the drawing of an arm, None for the default one.

    Without `for_pictures`, geoms without contact, materials and textures are left out: they cost time.
    The state is the same, so a run can be drawn with the other model. WrongMujoco tells another version.
    """
    if mujoco.__version__ != REQUIRED_MUJOCO:
        raise WrongMujoco(f"MuJoCo {mujoco.__version__} is installed, {REQUIRED_MUJOCO} is required")
    arm = arm or default_arm()
    spec = _load_scene(world.scene, arm, for_pictures).copy()
    attach_drawing(spec, arm.params)
    spec.option.gravity = FLIP * world.gravity_N_m_s2
    if world.surface is not None:
        add_rock(spec, np.array(world.surface.p_N_m), np.array(world.surface.normal_N), for_pictures)
        lower_ground(spec, -world.ground_N_m)
        if not for_pictures:
            _remove_visuals(spec)
    return spec


def check_plant(arm: ArmModel) -> None:
    """Check that MuJoCo accepts plant and looks of an arm, as lint does for the project's; BadArm if not."""
    problem = _find_plant_problem(arm)
    if problem is not None:
        raise BadArm(f"arm {arm.name}: MuJoCo does not accept its plant: {problem}")


@cache
def _find_plant_problem(arm: ArmModel) -> str | None:
    try:
        _load_scene("mars", arm, for_pictures=True).copy().compile()
    except ValueError as error:
        return " ".join(str(error).split())
    return None


@cache
def _load_scene(scene: Scene, arm: ArmModel, for_pictures: bool) -> mujoco.MjSpec:
    """Read a scene with an arm once in a process; callers change a copy."""
    parts = {path.name: path.read_bytes() for path in SCENES.glob("*.xml")}
    parts[ARM_FILE] = arm.mjcf.encode()
    if arm.has_own_rover:
        parts[ROVER_FILE] = NO_LOOKS
    text = INCLUDED_ARM.sub(ARM_FILE, parts[f"{scene}.xml"].decode())
    spec = mujoco.MjSpec.from_string(text, include=parts)
    if not for_pictures:
        _remove_visuals(spec)
    return spec


def _remove_visuals(spec: mujoco.MjSpec) -> None:
    """Remove geoms without contact, and materials and textures, which cost most of the time to compile."""
    for geom in list(spec.geoms):
        if geom.contype == 0 and geom.conaffinity == 0:
            spec.delete(geom)
        else:
            geom.material = ""
    for look in (*spec.materials, *spec.textures):
        spec.delete(look)


def params_in_world(world: World, params: Params) -> Params:
    """Set the height of the ground, as the cameras of the rover see it, in the flight parameters."""
    ground_z_m = float(world.ground_N_m - P_NR_M[2])
    return replace(params, collision=replace(params.collision, ground_z_m=ground_z_m))


def inside_rover(p_N_m: Vector3, arm: ArmModel | None = None) -> bool:
    """Return whether a point in RNAV is inside the hull of the rover of an arm, None for the default one."""
    spec = build(World(), arm)
    probe = spec.worldbody.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(1e-3, 0, 0))
    probe.pos = FLIP * np.array(p_N_m)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hull, probe_id = model.body(HULL), model.geom("probe").id
    geoms = range(hull.geomadr[0], hull.geomadr[0] + hull.geomnum[0])
    return any(mujoco.mj_geomDistance(model, data, geom, probe_id, 1.0, None) < 0 for geom in geoms)


def add_rock(spec: mujoco.MjSpec, p_N_m: Array, normal_N: Array, for_pictures: bool = False) -> None:
    """Add a flat disc of rock with contact, for pictures a boulder around it, and a camera on it."""
    z = FLIP * normal_N
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-6 else x / np.linalg.norm(x)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([x, np.cross(z, x), z]).ravel())
    face = FLIP * p_N_m
    rock = spec.worldbody.add_body(name="rock", pos=face, quat=quat)
    rock.add_geom(
        name="rock_face",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(ROCK_RADIUS_M, ROCK_HALF_DEPTH_M, 0),
        pos=(0, 0, -ROCK_HALF_DEPTH_M),
        contype=2,
        conaffinity=1,
        rgba=(0.66, 0.52, 0.42, 1),
    )
    _add_camera(spec, face)
    if for_pictures:
        _add_boulder(spec, face, z)
        if spec.body("rover").geoms:
            _show_mast(spec, face)


def _add_camera(spec: mujoco.MjSpec, face: Array) -> None:
    """Add the camera `target`, which sees the whole arm and the rock from the front starboard corner."""
    shoulder = spec.body("rmech").pos + FLIP * spec.body("arm1").pos
    lowest, highest = face - (0.0, 0.0, ROCK_HEIGHT_M), shoulder + np.array([0.0, 0.0, ELBOW_ABOVE_M])
    middle, radius_m = 0.5 * (lowest + highest), 0.5 * float(np.linalg.norm(highest - lowest))
    back = CAMERA_SIDE / np.linalg.norm(CAMERA_SIDE)
    eye = middle + back * radius_m / np.sin(0.5 * np.radians(FIELD_OF_VIEW_DEG))
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([right, np.cross(back, right), back]).ravel())
    spec.worldbody.add_camera(name="target", pos=eye, quat=quat, fovy=FIELD_OF_VIEW_DEG)


def _show_mast(spec: mujoco.MjSpec, face: Array) -> None:
    """Move the camera `target` until it sees the whole arm, the rock and the top of the mast, and no more."""
    camera = spec.camera("target")
    shoulder = spec.body("rmech").pos + FLIP * spec.body("arm1").pos
    elbow = shoulder + np.array([0.0, 0.0, ELBOW_ABOVE_M])
    seen = (face - (0.0, 0.0, ROCK_HEIGHT_M), face, elbow, FLIP * MAST_TOP_N_M)
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, camera.quat)
    x, y, z = axes.reshape(3, 3).T @ np.array(seen).T
    # a point is in the picture if |x - centre| <= slope (distance - z), and the same for y
    up = PICTURE_SHARE * np.tan(0.5 * np.radians(FIELD_OF_VIEW_DEG))
    edges = [((v + s * z).max(), (v - s * z).min(), s) for v, s in ((x, PICTURE_ASPECT * up), (y, up))]
    distance = max((high - low) / (2 * slope) for high, low, slope in edges)
    camera.pos = axes.reshape(3, 3) @ (*(0.5 * (high + low) for high, low, _ in edges), distance)


def lower_ground(spec: mujoco.MjSpec, height_m: float) -> None:
    """Move ground and scenery to a height (world z, at most 0), with a terrace under the rover."""
    if height_m == 0.0:
        return
    spec.geom("ground").pos[2] = height_m
    scenery = spec.body("mars_scenery")
    if scenery is not None:
        scenery.pos[2] = height_m
    spec.worldbody.add_geom(
        name="terrace",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(-0.15, 0, 0.5 * height_m),
        size=(1.5, 1.5, -0.5 * height_m),
        contype=0,
        conaffinity=0,
        group=2,
        material=spec.geom("ground").material,
    )


def _add_boulder(spec: mujoco.MjSpec, face: Array, z: Array) -> None:
    """Add a boulder from the face to below the ground; it has no contact, and nothing above the face."""
    ground_m = min(0.0, float(face[2]) - BELOW_ROCK_M)
    half_m = np.array([*BOULDER_HALF_M, 0.6 * (face[2] - ground_m) + 0.12])
    centre = face - 0.15 * z
    centre[2] = face[2] - 0.6 * half_m[2]
    vertices, faces = boulder(half_m, face - BEHIND_FACE_M * z - centre, z)
    spec.add_mesh(name="boulder", uservert=vertices.ravel(), userface=faces.ravel(), smoothnormal=False)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="boulder",
        pos=centre,
        contype=0,
        conaffinity=0,
        group=2,
        material="mars_rock" if spec.material("mars_rock") else "",
        rgba=(0.80, 0.74, 0.70, 1),
    )


TURRET: Final = "turret"


def attach_drawing(spec: mujoco.MjSpec, params: Params) -> None:
    """Add the temperature of the drawing, and expansion and length of its parts, to a specification."""
    expansion = {tool.name: tool.expansion_1_K for tool in params.tools}
    length = {}
    for body, link in zip(LINK_BODIES, params.links.in_order(), strict=True):
        X = transform6_to_pose(link.transform)
        expansion[body] = link.expansion_1_K
        length[body] = (X.R.T @ X.p).tolist()
    drawn = {"temperature_C": params.heat.calibration_C, "expansion_1_K": expansion, "length_m": length}
    spec.comment = json.dumps(drawn)


def expansion_of(spec: mujoco.MjSpec, body: str) -> Row6:
    """Return the expansion per kelvin of the link or tool that a frame body ends, in axes of its frame."""
    return row6(json.loads(spec.comment)["expansion_1_K"][body])


def scale_expansion(spec: mujoco.MjSpec, body: str, factor: float) -> None:
    """Scale the expansion of the link or tool that a frame body ends."""
    drawn = json.loads(spec.comment)
    drawn["expansion_1_K"][body] = [factor * value for value in drawn["expansion_1_K"][body]]
    spec.comment = json.dumps(drawn)


def grow(spec: mujoco.MjSpec, temperature_C: float) -> None:
    """Displace the frame at the end of each link and tool by its growth to a temperature."""
    drawn = json.loads(spec.comment)
    warming_K = temperature_C - drawn["temperature_C"]
    for body, expansion_1_K in drawn["expansion_1_K"].items():
        displace(spec.body(body), warming_K * np.array(expansion_1_K))


def displace(body: mujoco.MjsBody, screw: Array) -> None:
    """Displace a body by a small screw in its own axes, rotation first [rad, m], shape (6,)."""
    if not screw.any():
        return
    R, quat = np.zeros(9), np.zeros(4)
    mujoco.mju_quat2Mat(R, body.quat)
    X = Pose(R.reshape(3, 3), body.pos) @ screw_exp(screw)
    mujoco.mju_mat2Quat(quat, X.R.ravel())
    body.pos, body.quat = X.p, quat


def length_of(spec: mujoco.MjSpec, frame: Frame) -> Array:
    """Return the link that ends in a frame, from start to end [m], shape (3,), in axes of its end."""
    return np.array(json.loads(spec.comment)["length_m"][LINK_BODIES[frame]])


def tools_of(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Return the names of the tools: the bodies on the turret."""
    return tuple(body.name for body in spec.body(TURRET).bodies)
