"""World around the arm: tilt and gravity, frames, the rock face, and the position of the rover."""

import mujoco
import numpy as np
import pytest

from fsw.config import configure
from fsw.kinematics.chain import forward
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.transforms import rotation_x, rotation_y
from sim.arms import nominal_params
from sim.frames import FLIP, P_NR_M, p_R_from_N, random_surface
from sim.setting import Surface, World
from sim.world import WrongMujoco, add_rock, build, inside_rover

APEX = (2.1, 0.1, -0.3)
NORMAL = (-0.6, 0.1, -0.7)


@pytest.mark.parametrize("seed", range(10))
def test_gravity_is_seen_from_the_rover_and_the_tilt_is_its_angle(seed):
    roll, pitch = np.random.default_rng([19, seed]).uniform(-0.5, 0.5, 2)
    world = World("earth", float(roll), float(pitch))
    gravity = world.gravity_N_m_s2
    back_in_the_world = rotation_y(np.array(pitch)) @ rotation_x(np.array(roll)) @ gravity
    np.testing.assert_allclose(back_in_the_world, [0.0, 0.0, 9.81], atol=1e-12)
    assert world.tilt_rad == pytest.approx(np.arccos(gravity[2] / 9.81), abs=1e-9)


@pytest.mark.parametrize(
    "normal", [NORMAL, (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -2.0, 0.0)]
)
def test_the_rock_face_goes_through_its_point_and_looks_along_its_normal(normal):
    model = build(World(surface=Surface(APEX, normal))).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    outward = FLIP * np.array(normal) / np.linalg.norm(normal)
    side = np.cross(outward, [0.3, 0.5, 0.8])
    for aside_m in (0.0, 0.05, -0.05):
        start = FLIP * np.array(APEX) + 0.2 * outward + aside_m * side
        hit = np.zeros(1, np.int32)
        distance_m = mujoco.mj_ray(model, data, start, -outward, None, 1, -1, hit)
        assert model.geom(int(hit[0])).name == "rock_face"
        assert distance_m == pytest.approx(0.2, abs=1e-9)


def test_the_ground_is_under_the_rock_and_never_above_the_wheels():
    low = build(World(surface=Surface((2.1, 0.0, 0.2), NORMAL)))
    assert low.geom("ground").pos[2] == pytest.approx(-0.3)
    assert build(World(surface=Surface((2.1, 0.0, -0.5), NORMAL))).geom("ground").pos[2] == 0.0


@pytest.mark.parametrize("scene", ["mars", "earth"])
def test_leaving_out_what_only_looks_leaves_the_state_as_it_is(scene):
    world = World(scene, 0.1, 0.2, Surface(APEX, NORMAL))
    lean, full = build(world).compile(), build(world, for_pictures=True).compile()
    assert lean.ngeom < full.ngeom
    states = []
    for model in (lean, full):
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 50)
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(states[0], states[1])


@pytest.mark.parametrize(
    ("p_N_m", "inside"),
    [
        ((0.0, 0.0, -0.8), True),
        ((0.68, 0.48, -1.5), True),
        ((1.0, 1.13, -0.25), True),
        ((2.1, 0.0, -0.3), False),
        ((0.0, 0.0, -3.0), False),
        ((2.1, 0.0, 0.15), False),
    ],
    ids=["body", "mast", "wheel", "workspace", "above", "below the ground"],
)
def test_a_target_may_not_be_inside_the_rover(p_N_m, inside):
    assert inside_rover(p_N_m) is inside


def test_another_mujoco_is_refused(monkeypatch):
    monkeypatch.setattr(mujoco, "__version__", "4.0.0")
    with pytest.raises(WrongMujoco, match=r"4\.0\.0 is installed, 4\.0\.1 is required"):
        build(World())


@pytest.mark.parametrize("seed", range(3))
def test_the_camera_of_a_target_sees_the_whole_arm_and_the_rock(seed):
    arm = configure(nominal_params()).arm
    point, normal = random_surface(np.random.default_rng(seed))
    p_N_m, outward = np.array(point)[:, None], np.array(normal)[:, None]
    found = inverse_kinematics(arm, "apxs", p_R_from_N(p_N_m.T).T, -outward)
    spec = build(World(), for_pictures=True)
    add_rock(spec, p_N_m[:, 0], outward[:, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = model.camera("target").id
    eye, R = data.cam_xpos[camera], data.cam_xmat[camera].reshape(3, 3)
    upward = np.tan(0.5 * np.radians(model.cam_fovy[camera]))
    middle = 0.5 * (data.body("arm1").xpos + FLIP * p_N_m[:, 0])
    np.testing.assert_allclose((middle - eye) @ R[:, 0], 0.0, atol=1e-9)  # between shoulder and rock
    valid = found.verdict[:, 0] == BranchVerdict.VALID
    for output in found.output_rad[:, valid, 0].T:
        p_R = forward(arm, output[:, None]).X_RF.p[:, :, 0].T
        seen = (np.vstack([FLIP * (p_R + P_NR_M), FLIP * p_N_m[:, 0]]) - eye) @ R
        across, along = np.abs(seen[:, :2]).T / -seen[:, 2]
        assert np.all(across < 16 / 9 * upward)
        assert np.all(along < upward)
