"""The scene of a tilted rover, and triangles of shapes."""

import mujoco
import numpy as np
import pytest

from marsarm.render.rays import Rays, triangulate
from marsarm.render.rover_scene import tilt_rover
from sim.setting import Scene, Surface, World
from sim.world import build

ROCK = Surface((2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))
LOW_ROCK = Surface((2.05, 0.1, 0.2), (0.0, 0.0, -1.0))
TILTS_DEG = [(10.0, -5.0), (-20.0, 0.0), (0.0, 30.0)]


def drawn(world: World) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = build(world, for_pictures=True)
    tilt_rover(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def tilted(roll_deg: float, pitch_deg: float, scene: Scene = "mars", surface: Surface | None = ROCK) -> World:
    return World(scene, np.radians(roll_deg), np.radians(pitch_deg), surface)


def axes(data: mujoco.MjData, body: str) -> np.ndarray:
    return data.body(body).xmat.reshape(3, 3)


@pytest.mark.parametrize("scene", ["mars", "earth"])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), TILTS_DEG)
def test_gravity_points_down_and_the_rover_feels_it_as_in_the_run(scene, roll_deg, pitch_deg):
    world = tilted(roll_deg, pitch_deg, scene)
    model, data = drawn(world)
    np.testing.assert_array_equal(model.opt.gravity[:2], 0.0)
    for body in ("rover", "rmech"):
        np.testing.assert_allclose(axes(data, body).T @ model.opt.gravity, world.gravity_N_m_s2, atol=1e-12)


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), TILTS_DEG)
def test_the_horizon_is_level_on_all_sides(roll_deg, pitch_deg):
    model, data = drawn(tilted(roll_deg, pitch_deg, "earth"))
    azimuth = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    for height, seen in ((0.001, -1), (-0.001, model.geom("ground").id)):
        ray = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.full(12, height)])
        geom, _, _ = Rays(model).cast(data, np.array([0.0, 0.0, 20.0]), ray)
        assert set(geom.tolist()) == {seen}


@pytest.mark.parametrize("surface", [None, ROCK, LOW_ROCK], ids=["no rock", "rock", "rock below the wheels"])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), TILTS_DEG)
def test_rover_arm_and_rock_stay_together_on_the_slope(roll_deg, pitch_deg, surface):
    level = build(tilted(0.0, 0.0, surface=surface), for_pictures=True).compile()
    model, data = drawn(tilted(roll_deg, pitch_deg, surface=surface))
    before = mujoco.MjData(level)
    mujoco.mj_kinematics(level, before)
    turn = axes(data, "rover") @ axes(before, "rover").T

    def of_rover(data: mujoco.MjData) -> np.ndarray:
        named = ["turret"] if surface is None else ["turret", "rock"]
        return np.array([data.body(name).xpos - data.body("rover").xpos for name in named])

    np.testing.assert_allclose(of_rover(data), of_rover(before) @ turn.T, atol=1e-9)
    around = np.array([[0.0, 0.0], [2.0, 0.5], [-1.2, 1.1], [0.5, -2.2]])
    under_level = np.column_stack([around, np.full(4, level.geom("ground").pos[2])])
    on_slope = data.body("rover").xpos + (under_level - before.body("rover").xpos) @ turn.T
    up, slope = np.array([0.0, 0.0, 1.0]), model.geom("slope").id
    below_sky_m = [mujoco.mj_rayMesh(model, data, slope, point + 50.0 * up, -up, None) for point in on_slope]
    np.testing.assert_allclose(below_sky_m, 50.0, atol=1e-5)


def test_a_hill_has_no_edge_where_its_slope_ends_or_where_it_meets_the_plain():
    model, data = drawn(tilted(0.0, 30.0))
    down = np.array([0.0, 0.0, -1.0])
    x_m = np.linspace(-9.0, 9.0, 181)
    sky = np.column_stack([x_m, np.full_like(x_m, 3.5), np.full_like(x_m, 50.0)])
    geom = np.zeros(1, np.int32)
    from_sky_m = [mujoco.mj_ray(model, data, eye, down, None, True, -1, geom, None) for eye in sky]
    assert np.abs(np.diff(from_sky_m)).max() < 0.1 * np.tan(np.radians(50.0))


def test_a_level_rover_is_drawn_as_ever():
    spec = build(World(surface=ROCK), for_pictures=True)
    before = spec.to_xml()
    tilt_rover(spec)
    assert spec.to_xml() == before


MODEL = """
<mujoco>
  <asset><mesh name="corner" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
  <worldbody>
    <geom name="sphere" size="0.2"/>
    <geom name="capsule" type="capsule" size="0.1 0.3"/>
    <geom name="cylinder" type="cylinder" size="0.1 0.3"/>
    <geom name="ellipsoid" type="ellipsoid" size="0.1 0.2 0.3"/>
    <geom name="box" type="box" size="0.1 0.2 0.3"/>
    <geom name="mesh" type="mesh" mesh="corner"/>
    <geom name="plane" type="plane" size="2 3 1"/>
  </worldbody>
</mujoco>
"""
VOLUMES = {
    "sphere": 4 / 3 * np.pi * 0.2**3,
    "capsule": 4 / 3 * np.pi * 0.1**3 + 0.6 * np.pi * 0.1**2,
    "cylinder": 0.6 * np.pi * 0.1**2,
    "ellipsoid": 4 / 3 * np.pi * 0.1 * 0.2 * 0.3,
    "box": 0.2 * 0.4 * 0.6,
    "mesh": 1 / 6,
}


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


@pytest.mark.parametrize("name", VOLUMES)
def test_the_triangles_of_a_solid_enclose_its_volume_and_face_outward(model, name):
    found = triangulate(model, model.geom(name).id)
    a, b, c = found.vertices_m.astype(float)[found.faces].transpose(1, 0, 2)
    volume = np.sum(a * np.cross(b, c)) / 6
    assert volume == pytest.approx(VOLUMES[name], rel=0.07)
    # vertices at sharp edges are there twice
    place = np.unique(found.vertices_m.round(6) + 0.0, axis=0, return_inverse=True)[1].ravel()
    edges = np.sort(place[np.vstack([found.faces[:, [i, (i + 1) % 3]] for i in range(3)])], axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all(), "each edge of a closed surface belongs to two triangles"


def test_a_plane_has_its_size_and_faces_up(model):
    found = triangulate(model, model.geom("plane").id)
    assert np.ptp(found.vertices_m, axis=0).tolist() == [4.0, 6.0, 0.0]
    a, b, c = found.vertices_m[found.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
