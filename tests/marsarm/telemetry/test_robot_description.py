"""The robot description of a log shows what MuJoCo draws, in the frames of the transforms."""

from collections.abc import Iterator
from functools import reduce
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from fsw.config import configure
from fsw.kinematics.transforms import Pose, rotation_x, rotation_y, rotation_z
from helpers.marks import slow_but
from marsarm.telemetry.robot_description import draw_scene, visuals_of
from marsarm.telemetry.ros_messages import RosEncoder
from sim.arm_model.load import arm_names
from sim.arms import arm_named
from sim.frames import FLIP, P_NR_M
from sim.plant import Plant
from sim.setting import Surface, World
from sim.world import build, params_in_world

JOINTS = ("azimuth", "elevation", "elbow", "wrist", "turret")
FACE = Surface((2.05, 0.1, 0.15), (-0.5, 0.1, -0.85))
ANGLES_RAD = np.random.default_rng(24).uniform(-3.0, 3.0, (3, 5))


class Urdf:
    """Robot description, read by its XML alone."""

    def __init__(self, text: str) -> None:
        self.robot = ElementTree.fromstring(text)
        self.links = [link.attrib["name"] for link in self.robot.iter("link")]
        self.joint_to = {joint.find("child").attrib["link"]: joint for joint in self.robot.findall("joint")}

    def pose_in_map(self, link: str, angles: dict[str, float]) -> Pose:
        poses = []
        while link != "map":
            joint = self.joint_to[link]
            turn = rotation_z(np.array(angles.get(joint.attrib["name"], 0.0)))
            poses.append(origin_of(joint) @ Pose(turn, np.zeros(3)))
            link = joint.find("parent").attrib["link"]
        return reduce(lambda X, Y: Y @ X, poses)

    def shapes(self, link: str) -> Iterator[tuple[str, list[float], Pose]]:
        for visual in self.robot.find(f"link[@name='{link}']").iter("visual"):
            (shape,) = visual.find("geometry")
            sizes = [float(number) for text in shape.attrib.values() for number in text.split()]
            yield shape.tag, sizes, origin_of(visual)


def origin_of(part: ElementTree.Element) -> Pose:
    origin = part.find("origin")
    roll, pitch, yaw = map(float, origin.attrib["rpy"].split())
    return Pose(turned(roll, pitch, yaw), np.array(origin.attrib["xyz"].split(), float))


def turned(roll: float, pitch: float, yaw: float) -> Any:
    return rotation_z(np.array(yaw)) @ rotation_y(np.array(pitch)) @ rotation_x(np.array(roll))


def description_of(world: World, name: str) -> str:
    arm = arm_named(name)
    encoder = RosEncoder(configure(params_in_world(world, arm.params)), draw_scene(world, arm.model))
    data = dict(encoder.static_messages(0))["/robot_description"]
    assert int.from_bytes(data[4:8], "little") == len(data) - 8
    return data[8:-1].decode()


@pytest.fixture(scope="module")
def urdf() -> Urdf:
    return Urdf(description_of(World(surface=FACE), "nominal"))


def test_the_joints_are_those_of_joint_states(urdf: Urdf) -> None:
    moving = [joint for joint in urdf.joint_to.values() if joint.attrib["type"] == "revolute"]
    assert [joint.attrib["name"] for joint in moving] == list(JOINTS)
    for joint in moving:
        limit = {key: float(text) for key, text in joint.find("limit").attrib.items()}
        assert limit["lower"] < limit["upper"]
        assert min(limit["effort"], limit["velocity"]) > 0


@pytest.mark.parametrize("name", arm_names())
@pytest.mark.parametrize("draw", slow_but(range(3), 0))
def test_every_visible_geom_is_drawn_where_mujoco_has_it(name: str, draw: int) -> None:
    angles_rad = ANGLES_RAD[draw]
    world, arm = World(surface=FACE), arm_named(f"{name}/nominal")
    urdf = Urdf(description_of(world, f"{name}/nominal"))
    plant = Plant(build(world, arm.model, for_pictures=True).compile())
    plant.show(angles_rad, np.zeros((6, 6)))
    mujoco.mj_kinematics(plant.model, plant.data)
    angles = dict(zip(JOINTS, angles_rad.tolist(), strict=True))
    drawn = {"box": [], "cylinder": [], "sphere": []}
    for link in urdf.links:
        X_ML = urdf.pose_in_map(link, angles) if link != "map" else None
        for shape, sizes, X_LV in urdf.shapes(link):
            X = X_ML @ X_LV
            drawn[shape].append([*X.p, *sizes, *X.R[:, 2]])
    assert_all_are_among(expected(plant), drawn)
    assert all(drawn.values())


def expected(plant: Plant) -> dict[str, list[list[float]]]:
    """Return place, size and z axis of the shapes of the visible geoms, in the root frame."""
    model, data = plant.model, plant.data
    found = {"box": [], "cylinder": [], "sphere": []}
    for geom in range(model.ngeom):
        kind, (a, b, c) = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
        is_decoration = model.body(model.geom_bodyid[geom]).name == "mars_scenery"
        if model.geom_group[geom] >= 3 or kind == mujoco.mjtGeom.mjGEOM_PLANE or is_decoration:
            continue
        z = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        p = data.geom_xpos[geom] - FLIP * P_NR_M
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            centre, half = model.geom_aabb[geom].reshape(2, 3)
            middle = p + data.geom_xmat[geom].reshape(3, 3) @ centre
            found["box"].append([*middle, *(2 / np.sqrt(3.0) * half), *z])
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            found["box"].append([*p, 2 * a, 2 * b, 2 * c, *z])
        if kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
            found["cylinder"].append([*p, a, 2 * b, *z])
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            found["sphere"] += [[*(p + end * z), a, *z] for end in (-b, b)]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            found["sphere"].append([*p, a, *z])
    return found


def assert_all_are_among(expected: dict[str, Any], drawn: dict[str, Any]) -> None:
    for shape, rows in expected.items():
        for row in rows:
            assert np.abs(np.array(drawn[shape]) - row).max(axis=1).min() < 1e-6
    # beside these only the ground is drawn
    assert {shape: len(rows) for shape, rows in drawn.items()} == {
        shape: len(rows) + (shape == "box") for shape, rows in expected.items()
    }


def test_the_face_of_the_rock_is_where_the_world_has_it(urdf: Urdf) -> None:
    X = urdf.pose_in_map("rock", {})
    np.testing.assert_allclose(X.p, FLIP * (np.array(FACE.p_N_m) - P_NR_M), atol=1e-8)
    normal = np.array(FACE.normal_N) / np.linalg.norm(FACE.normal_N)
    np.testing.assert_allclose(X.R[:, 2], FLIP * normal, atol=1e-8)
    ((shape, sizes, X_RV),) = urdf.shapes("rock")
    assert shape == "cylinder"
    assert X_RV.p[2] + 0.5 * sizes[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("world", slow_but([World(), World("earth"), World(surface=FACE)], World("earth")))
def test_the_ground_is_as_high_as_the_world_has_it(world: World) -> None:
    urdf = Urdf(description_of(world, "nominal"))
    (shape, sizes, X_GV), *_ = urdf.shapes("ground")
    top = (urdf.pose_in_map("ground", {}) @ X_GV).p[2] + 0.5 * sizes[2]
    assert (shape, top) == ("box", pytest.approx(P_NR_M[2] - world.ground_N_m, abs=1e-8))
    assert ("rock" in urdf.links) == (world.surface is not None)


def test_a_shape_that_urdf_lacks_is_drawn_as_the_box_around_it() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=(0.1, 0.2, 0.3), pos=(1, 2, 3))
    (visual,) = visuals_of(spec.compile(), 0, Pose(np.eye(3), np.array([1.0, 2.0, 3.0])))
    assert (visual.shape, visual.size_m) == ("box", pytest.approx((0.2, 0.4, 0.6)))
    np.testing.assert_allclose(visual.X.p, (1, 2, 3))
