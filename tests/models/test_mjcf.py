"""Properties of the models in models/mjcf on which the project depends."""

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

pytestmark = pytest.mark.filterwarnings("error")

Array = npt.NDArray[np.float64]

MJCF = Path(__file__).resolve().parents[2] / "models" / "mjcf"
ARM = MJCF.parent / "arms" / "msl"
FRAGMENTS = sorted(p.name for p in MJCF.glob("*_fragment.xml"))
FILES = ["arm.xml", *sorted(p.name for p in MJCF.glob("*.xml") if p.name not in FRAGMENTS)]
SCENES = {"mars.xml": 3.711, "earth.xml": 9.81}

JOINTS = ("azimuth", "elevation", "elbow", "wrist", "turret")
STOWED_DEG = (89.86, -15.91, -161.89, 178.57, 34.01)
READY_DEG = (0.0, -60.0, 110.0, 130.0, 90.0)
UNSTOW_DEG = (STOWED_DEG, (70.0, -40.0, -130.0, 160.0, 40.0), (0.0, -80.0, -40.0, 130.0, 90.0), READY_DEG)
SOFT_LIMITS_DEG = ((-180.2, 91.2), (-187.2, 7.2), (-164.2, 164.2), (-190.2, 210.2), (-20.2, 330.0))

# The nominal table of MSL-476-1303: a, d [m] and alpha [deg] of each joint; the first joint's origin in RNAV.
DH = ((0.156, 0.0, 90.0), (0.827, 0.0, 0.0), (0.785, 0.0, 0.0), (-0.144, -0.1664, -90.0), (0.0, -0.1697, 0.0))
AZIMUTH_RNAV_M = (0.09002 + 1.11285, -0.4515, -1.1205 + 0.2660)
# Angle about the turret axis [deg], radius and height [m], clocking about the tool's own x [deg].
TOOLS = {
    "drill": (0.0, 0.360, -0.0718, 0.0),
    "drt": (70.25, 0.299, -0.0868, 0.0),
    "mahli": (122.5, 0.2973, -0.0798, 120.0),
    "apxs": (-133.0, 0.2983, -0.0771, 0.0),
    "portion": (-89.79, 0.2761, -0.1105, 0.0),
}
SWITCHES = {
    "apxs_1": "apxs",
    "apxs_2": "apxs",
    "drill_1": "drill",
    "drill_2": "drill",
    "mahli_1a": "mahli",
    "mahli_1b": "mahli",
    "mahli_2a": "mahli",
    "mahli_2b": "mahli",
    "drt_1": "drt",
    "drt_2": "drt",
}


def path_of(name: str) -> Path:
    return (ARM if name == "arm.xml" else MJCF) / name


def load(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(path_of(name)))


def set_pose(model: mujoco.MjModel, pose_deg: tuple[float, ...]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for joint, angle_deg in zip(JOINTS, pose_deg, strict=True):
        data.joint(f"{joint}_motor").qpos[0] = np.radians(angle_deg)
    mujoco.mj_forward(model, data)
    return data


def turn(axis: str, angle_deg: float) -> Array:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    T = np.eye(4)
    if axis == "z":
        T[:2, :2] = [[c, -s], [s, c]]
    else:
        T[1:3, 1:3] = [[c, -s], [s, c]]
    return T


def shift(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return T


def nominal_tool_in_rnav(tool: str, pose_deg: tuple[float, ...]) -> Array:
    T = shift(*AZIMUTH_RNAV_M)
    for (a_m, d_m, alpha_deg), angle_deg in zip(DH, pose_deg, strict=True):
        T = T @ turn("z", angle_deg) @ shift(0, 0, d_m) @ shift(a_m, 0, 0) @ turn("x", alpha_deg)
    angle_deg, radius_m, height_m, clocking_deg = TOOLS[tool]
    return T @ turn("z", angle_deg) @ shift(radius_m, 0, height_m) @ turn("x", clocking_deg)


def is_arm(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a body moves, as only those of the arm do."""
    return bool(model.body_weldid[model.geom_bodyid[geom]] != 0)


@pytest.mark.parametrize("name", FILES)
def test_every_file_but_the_fragments_opens_by_itself(name: str) -> None:
    assert load(name).nbody >= 1


@pytest.mark.parametrize("name", FRAGMENTS)
def test_a_fragment_says_so_and_is_included(name: str) -> None:
    assert (MJCF / name).read_text().startswith("<mujocoinclude>")
    assert any(f'<include file="{name}"/>' in path_of(f).read_text() for f in FILES)


@pytest.mark.parametrize("name", FILES + FRAGMENTS)
def test_files_stay_readable(name: str) -> None:
    assert len(path_of(name).read_text().splitlines()) < 400


@pytest.mark.parametrize(("scene", "gravity_m_s2"), SCENES.items())
def test_a_scene_changes_only_the_gravity_of_the_arms_options(scene: str, gravity_m_s2: float) -> None:
    arm, model = load("arm.xml"), load(scene)
    assert model.opt.gravity.tolist() == [0.0, 0.0, -gravity_m_s2]
    assert model.opt.timestep == arm.opt.timestep
    assert model.opt.cone == arm.opt.cone
    assert model.opt.impratio == arm.opt.impratio
    assert model.opt.integrator == arm.opt.integrator
    assert model.opt.tolerance == arm.opt.tolerance
    assert model.opt.disableflags == arm.opt.disableflags
    assert model.opt.enableflags == arm.opt.enableflags


def test_the_scenes_add_no_freedom_and_no_mass() -> None:
    arm = load("arm.xml")
    for scene in SCENES:
        model = load(scene)
        assert model.nq == arm.nq
        assert model.body_mass.sum() == pytest.approx(arm.body_mass.sum(), abs=1e-12)


def test_arm_and_turret_weigh_what_the_paper_says() -> None:
    model = load("arm.xml")
    assert model.body_mass.sum() == pytest.approx(65 + 30, abs=1e-9)
    assert model.body("turret").mass[0] == 30
    assert model.body_subtreemass[model.body("turret").id] == 30


@pytest.mark.parametrize("scene", SCENES)
def test_leaving_the_decoration_out_does_not_change_the_motion(scene: str) -> None:
    """Compare bits: a plant without pictures compiles with discardvisual, for speed."""
    spec = mujoco.MjSpec.from_file(str(MJCF / scene))
    spec.compiler.discardvisual = True
    full, lean = load(scene), spec.compile()
    assert lean.ngeom < full.ngeom
    one, other = set_pose(full, READY_DEG), set_pose(lean, READY_DEG)
    mujoco.mj_step(full, one, 200)
    mujoco.mj_step(lean, other, 200)
    assert np.array_equal(one.qpos, other.qpos)
    assert not one.warning.number.any()


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("pose_deg", [(0.0,) * 5, STOWED_DEG, READY_DEG, (-35.0, -70.0, 95.0, 20.0, 215.0)])
def test_tool_frames_stand_where_the_nominal_table_puts_them(tool: str, pose_deg: tuple[float, ...]) -> None:
    site = set_pose(load("arm.xml"), pose_deg).site(tool)
    expected = turn("x", 180.0) @ nominal_tool_in_rnav(tool, pose_deg)  # MuJoCo's world is RNAV turned over
    np.testing.assert_allclose(site.xpos, expected[:3, 3], atol=1e-12)
    np.testing.assert_allclose(site.xmat.reshape(3, 3), expected[:3, :3], atol=1e-12)


def test_switches_are_touch_sensors_in_the_order_of_the_dictionary() -> None:
    model = load("arm.xml")
    touch = [i for i in range(model.nsensor) if model.sensor_type[i] == mujoco.mjtSensor.mjSENS_TOUCH]
    assert [model.sensor(i).name for i in touch] == list(SWITCHES)
    for i in touch:
        assert model.site(model.sensor_objid[i]).name == model.sensor(i).name


@pytest.mark.parametrize(("switch", "tool"), SWITCHES.items())
def test_a_pad_ends_in_the_plane_of_its_tool_frame(switch: str, tool: str) -> None:
    model = load("arm.xml")
    pad, site = model.geom(f"{switch}_pad"), model.site(switch)
    assert model.body(pad.bodyid[0]).name == model.body(site.bodyid[0]).name == tool
    assert pad.type[0] == mujoco.mjtGeom.mjGEOM_SPHERE
    assert pad.size[0] == 0.006
    assert pad.pos[0] + pad.size[0] == 0.0
    assert 0.02 <= np.hypot(pad.pos[1], pad.pos[2]) <= 0.05
    np.testing.assert_array_equal(site.pos, pad.pos)
    assert site.size[0] > pad.size[0]


@pytest.mark.parametrize("tool", sorted(set(SWITCHES.values())))
def test_the_pads_of_a_tool_balance_about_its_axis(tool: str) -> None:
    model = load("arm.xml")
    pads = [model.geom(f"{s}_pad").pos[1:] for s, t in SWITCHES.items() if t == tool]
    np.testing.assert_allclose(np.sum(pads, axis=0), 0.0, atol=1e-15)


@pytest.mark.parametrize("tool", sorted(set(SWITCHES.values())))
def test_what_is_behind_the_pads_stands_back(tool: str) -> None:
    model = load("arm.xml")
    data = set_pose(model, (0.0,) * 5)
    frame = data.site(tool)
    body = model.body(tool).id
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        if model.geom_bodyid[geom] == body and model.geom_contype[geom] and not name.endswith("_pad"):
            R_TG = frame.xmat.reshape(3, 3).T @ data.geom_xmat[geom].reshape(3, 3)
            p_TG = frame.xmat.reshape(3, 3).T @ (data.geom_xpos[geom] - frame.xpos)
            centre, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
            foremost_m = p_TG[0] + R_TG[0] @ centre + np.abs(R_TG[0]) @ half
            assert foremost_m <= -0.005, (tool, foremost_m)


@pytest.mark.parametrize("scene", SCENES)
def test_the_arm_can_touch_rover_and_ground_but_not_itself(scene: str) -> None:
    model = load(scene)
    for geom in range(model.ngeom):
        masks = (int(model.geom_contype[geom]), int(model.geom_conaffinity[geom]))
        assert masks in ({(0, 0), (1, 2)} if is_arm(model, geom) else {(0, 0), (2, 1)})
    assert {1, 2} <= set(model.geom_contype.tolist())


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("pose_deg", [STOWED_DEG, READY_DEG], ids=["stowed", "ready"])
def test_nothing_touches_at_the_named_poses(scene: str, pose_deg: tuple[float, ...]) -> None:
    assert set_pose(load(scene), pose_deg).ncon == 0


@pytest.mark.parametrize("scene", SCENES)
def test_nothing_touches_on_the_way_from_stowed_to_ready(scene: str) -> None:
    model = load(scene)
    for start, end in pairwise(UNSTOW_DEG):
        for pose_deg in np.linspace(start, end, 151):
            assert set_pose(model, tuple(pose_deg)).ncon == 0, pose_deg


def test_the_way_from_stowed_to_ready_is_inside_the_soft_limits() -> None:
    low_deg, high_deg = np.array(SOFT_LIMITS_DEG).T
    for pose_deg in UNSTOW_DEG:
        assert np.all(low_deg <= pose_deg)
        assert np.all(pose_deg <= high_deg)


def test_switches_close_on_a_flat_surface_before_anything_else_touches() -> None:
    """Press the drill on a flat wall: only the two prongs touch."""
    spec = mujoco.MjSpec.from_file(str(MJCF / "mars.xml"))
    drill = set_pose(load("mars.xml"), READY_DEG).site("drill")
    outward = drill.xmat.reshape(3, 3)[:, 0]
    wall = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2] * 3, contype=2, conaffinity=1)
    wall.pos = drill.xpos + (0.2 - 0.001) * outward  # the plane stands 1 mm inside the pads
    model = spec.compile()
    data = set_pose(model, READY_DEG)
    pads = {model.geom(g).name for pair in data.contact.geom for g in pair if is_arm(model, g)}
    assert pads == {"drill_1_pad", "drill_2_pad"}
    mujoco.mj_step(model, data)
    closed = {name for name in SWITCHES if data.sensor(name).data[0] > 0}
    assert closed == {"drill_1", "drill_2"}


@pytest.mark.parametrize("camera", ["overview", "workspace", "turret", "side"])
@pytest.mark.parametrize("scene", SCENES)
def test_the_cameras_are_there_and_pictures_may_be_large(scene: str, camera: str) -> None:
    model = load(scene)
    assert model.camera(camera).id >= 0
    assert model.vis.global_.offwidth >= 1600
    assert model.vis.global_.offheight >= 1200


def test_no_rock_stands_in_the_workspace() -> None:
    """Check the cylinder 0.8 m across about RNAV x = 2.1 m; sim/world.py puts the targets there."""
    model = load("mars_ground.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            distance_m = np.hypot(data.geom_xpos[geom][0] - 2.1, data.geom_xpos[geom][1])
            assert distance_m - model.geom_rbound[geom] > 0.4
