"""Properties of the models in models/mjcf on which the project depends."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.tools import TOOL_SWITCHES, WITH_SWITCHES

pytestmark = pytest.mark.filterwarnings("error")


MJCF = Path(__file__).resolve().parents[2] / "models" / "mjcf"
ARM = MJCF.parent / "arms" / "msl"
SCENES = {"mars.xml": 3.711, "earth.xml": 9.81}

JOINTS = ("azimuth", "elevation", "elbow", "wrist", "turret")
STOWED_DEG = (89.86, -15.91, -161.89, 178.57, 34.01)
READY_DEG = (0.0, -60.0, 110.0, 130.0, 90.0)


def load(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str((ARM if name == "arm.xml" else MJCF) / name))


def set_pose(model: mujoco.MjModel, pose_deg: tuple[float, ...]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for joint, angle_deg in zip(JOINTS, pose_deg, strict=True):
        data.joint(f"{joint}_motor").qpos[0] = np.radians(angle_deg)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize(("scene", "gravity_m_s2"), SCENES.items())
def test_a_scene_changes_only_the_gravity_of_the_arm(scene, gravity_m_s2):
    arm, model = load("arm.xml"), load(scene)
    assert model.opt.gravity.tolist() == [0.0, 0.0, -gravity_m_s2]
    for name in ("timestep", "cone", "impratio", "integrator", "tolerance", "disableflags", "enableflags"):
        assert getattr(model.opt, name) == getattr(arm.opt, name)
    assert model.nq == arm.nq
    assert {model.camera(k).name for k in range(model.ncam)} >= {"overview", "workspace", "side"}
    assert model.body_mass.sum() == pytest.approx(arm.body_mass.sum(), abs=1e-12)


@pytest.mark.parametrize("tool", WITH_SWITCHES)
def test_the_pads_of_a_tool_end_in_the_plane_of_its_frame_and_balance_about_its_axis(tool):
    model, balance = load("arm.xml"), np.zeros(2)
    for switch in TOOL_SWITCHES[tool]:
        pad, site = model.geom(f"{switch}_pad"), model.site(switch)
        assert model.body(pad.bodyid[0]).name == model.body(site.bodyid[0]).name == tool
        assert pad.type[0] == mujoco.mjtGeom.mjGEOM_SPHERE
        assert pad.size[0] == 0.006
        assert pad.pos[0] + pad.size[0] == 0.0
        assert 0.02 <= np.hypot(pad.pos[1], pad.pos[2]) <= 0.05
        np.testing.assert_array_equal(site.pos, pad.pos)
        assert site.size[0] > pad.size[0]
        balance += pad.pos[1:]
    np.testing.assert_allclose(balance, 0.0, atol=1e-15)


@pytest.mark.parametrize("tool", WITH_SWITCHES)
def test_what_is_behind_the_pads_stands_back(tool):
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
def test_the_arm_can_touch_rover_and_ground_but_not_itself(scene):
    model = load(scene)
    for geom in range(model.ngeom):
        masks = (int(model.geom_contype[geom]), int(model.geom_conaffinity[geom]))
        is_arm = model.body_weldid[model.geom_bodyid[geom]] != 0  # only bodies of the arm move
        assert masks in ({(0, 0), (1, 2)} if is_arm else {(0, 0), (2, 1)})
    assert {1, 2} <= set(model.geom_contype.tolist())


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("pose_deg", [STOWED_DEG, READY_DEG], ids=["stowed", "ready"])
def test_nothing_touches_at_the_named_poses(scene, pose_deg):
    assert set_pose(load(scene), pose_deg).ncon == 0


def test_no_rock_stands_in_the_workspace():
    """Check the cylinder 0.8 m across about RNAV x = 2.1 m; sim/world.py puts the targets there."""
    model = load("mars_ground.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            distance_m = np.hypot(data.geom_xpos[geom][0] - 2.1, data.geom_xpos[geom][1])
            assert distance_m - model.geom_rbound[geom] > 0.4
