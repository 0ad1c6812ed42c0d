"""Clearances of the arm to rover, ground and the surface of a target, with MuJoCo as the reference."""

from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np
import pytest

from fsw.collision.distance import UP, compute_clearances, limit_surface
from fsw.collision.geometry import GROUND, SURFACE, SURFACE_FRAME, TargetSurface
from fsw.config import configure
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from sim.frames import FLIP, P_NR_M
from sim.plant import Plant
from sim.setting import World
from sim.world import build
from tests.fsw.rig import MARS_R_m_s2, beside_the_rover, find_violation, in_limits, with_params
from tests.tools import TOOLS

NAMES = {"shoulder_bracket_2": "shoulder_bracket"}
FAR_M = 10.0
CONFIG = beside_the_rover()
GEOMETRY = CONFIG.collision_geometry
PARTS, OBSTACLES, TITLES = GEOMETRY.parts, GEOMETRY.obstacles[:SURFACE], GEOMETRY.titles
SHAPES = CONFIG.params.collision
PADDING_M = SHAPES.padding_m
LINKS = ("link2", "link3", "link4")
PRISM_M = 0.0045
"""Largest distance by which the prism of the turret's core is outside the core, at the edges."""
ROUNDING_M = 2e-6
READY = np.array(CONFIG.params.poses.ready_rad)
AT_READY = forward(CONFIG.arm, READY[:, None])
COUNTED = [k for k in range(len(PARTS)) if GEOMETRY.arm.carrier[GEOMETRY.arm.part == k][0] >= SURFACE_FRAME]


@lru_cache
def plant() -> Plant:
    """Build a plant with arm, rover and level ground."""
    return Plant(build(World()).compile())


def part_of(model: mujoco.MjModel, geom: int) -> str:
    name: str = model.body(model.geom_bodyid[geom]).name
    return name


def obstacle_of(model: mujoco.MjModel, geom: int) -> str:
    name = model.geom(geom).name
    return NAMES.get(name, name)


def mujoco_clearances(output_rad: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Compute the distances (PARTS, OBSTACLES, n) of MuJoCo's geoms at poses (5, n) and strains (6, 6, n)."""
    model, data = plant().model, plant().data
    arm, others = (
        [geom for geom in range(model.ngeom) if model.geom_contype[geom] == side] for side in (1, 2)
    )
    distance = np.full((len(PARTS), len(OBSTACLES), output_rad.shape[1]), np.inf)
    for k in range(output_rad.shape[1]):
        plant().show(output_rad[:, k], strain[:, :, k])
        for a in arm:
            i = PARTS.index(part_of(model, a))
            for b in others:
                j = OBSTACLES.index(obstacle_of(model, b))
                d = mujoco.mj_geomDistance(model, data, a, b, FAR_M, None)
                distance[i, j, k] = min(distance[i, j, k], d)
    return distance


def collides_only(params):
    """Remove the shapes of parts that only have visual geoms in MuJoCo: sieves, percussion, dust cover."""
    arm = params.collision.arm
    turret = replace(arm.turret, boxes=arm.turret.boxes[:-1])
    tools = tuple(
        replace(tool, geometry=replace(tool.geometry, capsules=tool.geometry.capsules[:-1]))
        if tool.name in ("drill", "mahli")
        else tool
        for tool in params.tools
    )
    return with_params(collision={"arm": replace(arm, turret=turret)}, tools=tools)


def settle_poses(poses_rad):
    return settle_output(CONFIG.arm, poses_rad, MARS_R_m_s2)


@pytest.fixture(scope="module")
def compared():
    """Compute clearances of random poses: ours, ours with the colliding shapes only, and MuJoCo's."""
    poses = in_limits(CONFIG, np.random.default_rng(31), 60)
    at_rest = settle_poses(poses)
    same = collides_only(CONFIG.params)
    ours, alike = (
        compute_clearances(geometry, at_rest.frames, FAR_M).near_m[:, :SURFACE]
        for geometry in (GEOMETRY, same.collision_geometry)
    )
    return ours, alike, mujoco_clearances(poses, at_rest.strain)


def test_the_arm_is_never_closer_in_mujoco_than_flight_software_takes_it_to_be(compared):
    ours, _, theirs = compared
    assert np.isfinite(theirs).any(axis=2).sum() == len(OBSTACLES) * (len(PARTS) - 2)
    assert (ours <= np.maximum(theirs, 0.0) + ROUNDING_M).all()


@pytest.mark.parametrize("part", [*LINKS, "turret"])
def test_links_are_as_close_to_everything_as_in_mujoco_and_the_turret_at_most_half_a_centimetre_closer(
    compared, part
):
    ours, alike, theirs = (apart[PARTS.index(part)] for apart in compared)
    clear = theirs > 0
    assert clear.mean() > 0.5
    if part == "turret":
        assert (theirs - alike)[clear].max() <= PRISM_M
    else:
        np.testing.assert_allclose(ours[clear], theirs[clear], atol=ROUNDING_M)


def test_every_geom_that_collides_belongs_to_a_part_or_an_obstacle():
    model = plant().model
    of_arm = {part_of(model, geom) for geom in range(model.ngeom) if model.geom_contype[geom] == 1}
    others = {obstacle_of(model, geom) for geom in range(model.ngeom) if model.geom_contype[geom] == 2}
    assert of_arm == set(PARTS) - {"link5", "portion"}
    assert others == set(OBSTACLES)


def test_parts_in_the_turret_frame_move_with_the_tools_of_the_parameters():
    """A drill that is calibrated as 3 cm longer is 3 cm closer to the obstacle ahead of it."""
    drill, *others = CONFIG.params.tools
    assert drill.name == "drill"
    longer = replace(drill, transform=replace(drill.transform, a_m=0.39))
    other = with_params(tools=(longer, *others))
    X_FT, X_FT_longer = CONFIG.arm.X_FT["drill"], other.arm.X_FT["drill"]
    of_drill = GEOMETRY.arm.part == PARTS.index("drill")
    shift = (other.collision_geometry.arm.X_CS.p - GEOMETRY.arm.X_CS.p)[:, of_drill]
    np.testing.assert_allclose(shift, np.tile((X_FT_longer.p - X_FT.p)[:, None], shift.shape[1]), atol=1e-15)


def test_distances_beyond_what_is_asked_for_are_left_out_and_the_others_are_the_same():
    frames = settle_poses(in_limits(CONFIG, np.random.default_rng(32), 100)).frames
    everything = compute_clearances(GEOMETRY, frames, FAR_M).near_m
    near = compute_clearances(GEOMETRY, frames, 0.05).near_m
    np.testing.assert_array_equal(near, np.where(everything <= 0.05, everything, np.inf))


def test_the_height_above_ground_follows_the_parameter():
    frames = settle_poses(in_limits(CONFIG, np.random.default_rng(33), 20)).frames
    lower = configure(replace(CONFIG.params, collision=replace(SHAPES, ground_z_m=SHAPES.ground_z_m + 0.2)))
    here, there = (
        compute_clearances(config.collision_geometry, frames, FAR_M).near_m[:, GROUND]
        for config in (CONFIG, lower)
    )
    np.testing.assert_allclose(there, here + 0.2, atol=1e-12)


def lowered_onto_the_ground(steps=60):
    """Return frames of a path on which the elevation turns the turret into the ground."""
    poses = np.tile(READY[:, None], steps)
    poses[1] += np.linspace(0.0, 0.6, steps)
    return forward(CONFIG.arm, poses)


def test_a_way_into_the_ground_is_refused_with_part_obstacle_and_distance():
    frames = lowered_onto_the_ground()
    close = find_violation(GEOMETRY, frames, PADDING_M)
    assert close.obstacle == "ground"
    apart = compute_clearances(GEOMETRY, frames, FAR_M).near_m
    assert apart[..., : close.first].min() >= PADDING_M
    assert apart[..., close.first].min() < PADDING_M
    assert close.distance_m == apart[PARTS.index(close.part), GROUND].min()
    assert close.reason == f"the {TITLES[close.part]} meets the ground"


def test_what_does_not_meet_is_refused_by_how_close_it_comes():
    height = compute_clearances(GEOMETRY, lowered_onto_the_ground(), FAR_M).near_m[:, GROUND].min(axis=0)
    few = int(np.flatnonzero(height < PADDING_M)[0]) + 1
    frames = lowered_onto_the_ground()
    until = type(frames)(frames.X_RL[:, :few], frames.X_LD, frames.X_RF[:, :few])
    close = find_violation(GEOMETRY, until, PADDING_M)
    assert 0 < close.distance_m < PADDING_M
    assert close.reason == (
        f"the {TITLES[close.part]} comes within {1e3 * close.distance_m:.1f} mm "
        "of the ground, at least 15.0 mm are to be kept"
    )


def test_a_tool_that_is_to_touch_may_come_as_close_as_it_likes_and_nothing_else_may():
    frames = lowered_onto_the_ground()
    everything = compute_clearances(GEOMETRY, frames, FAR_M).near_m
    for tool in TOOLS:
        apart = compute_clearances(GEOMETRY, frames, FAR_M, touching=tool).near_m
        exempt = PARTS.index(tool)
        assert np.isinf(apart[exempt]).all()
        others = np.arange(len(PARTS)) != exempt
        np.testing.assert_array_equal(apart[others], everything[others])


def test_the_way_out_of_the_padding_is_free_and_the_way_farther_in_is_not():
    frames = lowered_onto_the_ground(steps=200)
    height = compute_clearances(GEOMETRY, frames, FAR_M).near_m[:, GROUND].min(axis=0)
    inside = np.flatnonzero((height > 0) & (height < PADDING_M))
    assert inside.size >= 2
    k = int(inside[0])
    part_way = type(frames)(frames.X_RL[:, : k + 1], frames.X_LD, frames.X_RF[:, : k + 1])
    back = type(frames)(part_way.X_RL[:, ::-1], frames.X_LD, part_way.X_RF[:, ::-1])
    assert find_violation(GEOMETRY, back, PADDING_M) is None
    onward = type(frames)(frames.X_RL[:, k:], frames.X_LD, frames.X_RF[:, k:])
    close = find_violation(GEOMETRY, onward, PADDING_M)
    assert close.least_m == pytest.approx(height[k], abs=1e-4)
    assert close.first == 1


def test_to_be_close_to_one_thing_gives_no_leave_to_come_close_to_another():
    """The path starts with a tool within the padding above the ground, and ends at the mast."""
    height = (
        compute_clearances(GEOMETRY, lowered_onto_the_ground(steps=200), FAR_M).near_m[:, GROUND].min(axis=0)
    )
    k = int(np.flatnonzero((height > 0) & (height < PADDING_M))[0])
    start = READY + np.array([0.0, 0.6 * k / 199, 0.0, 0.0, 0.0])
    way = np.column_stack([start, READY, pose_that_meets("mast")])
    close = find_violation(GEOMETRY, forward(CONFIG.arm, way), PADDING_M)
    assert (close.first, close.obstacle) == (2, "mast")


def pose_that_meets(obstacle):
    """Find a random pose within the limits that collides with this obstacle and no other."""
    poses = in_limits(CONFIG, np.random.default_rng(35), 20_000)
    for some in np.split(poses, 20, axis=1):
        met = (compute_clearances(GEOMETRY, forward(CONFIG.arm, some), 0.0).near_m <= 0).any(axis=0)
        only = met[OBSTACLES.index(obstacle)] & (met.sum(axis=0) == 1)
        if only.any():
            return some[:, only.argmax()]
    raise AssertionError(f"no pose meets the {obstacle} alone")


@pytest.mark.parametrize("obstacle", OBSTACLES)
def test_whatever_the_arm_meets_is_named(obstacle):
    way = np.column_stack([READY, pose_that_meets(obstacle)])
    close = find_violation(GEOMETRY, forward(CONFIG.arm, way), PADDING_M)
    assert close.obstacle == obstacle
    assert close.reason.endswith(f" meets the {obstacle.replace('_', ' ')}")


def test_no_point_of_the_arm_is_farther_from_a_joint_than_its_lever():
    frames = settle_poses(in_limits(CONFIG, np.random.default_rng(34), 200)).frames
    for tool in TOOLS:
        tip = np.einsum("ijn,j->in", frames.X_RF.R[:, :, 5], CONFIG.arm.X_FT[tool].p) + frames.X_RF.p[:, 5]
        for joint in range(5):
            away = np.linalg.norm(tip - frames.X_RL.p[:, joint + 1], axis=0)
            assert (away <= GEOMETRY.lever_m[joint]).all()


def random_surfaces(seed, count):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    for normal, p in zip(normals, rng.uniform((1.0, -0.6, -0.2), (2.4, 0.6, 1.2), (count, 3)), strict=True):
        yield TargetSurface(p, normal / np.linalg.norm(normal))


def heights(frames, surface):
    return compute_clearances(GEOMETRY, frames, FAR_M, surface=surface).near_m[:, SURFACE]


def test_level_ground_as_a_surface_has_the_distances_of_the_ground_to_the_last_bit():
    frames = forward(CONFIG.arm, in_limits(CONFIG, np.random.default_rng(1), 200))
    ground = TargetSurface(np.array([0.0, 0.0, GEOMETRY.ground_z_m]), UP)
    clearance = compute_clearances(GEOMETRY, frames, FAR_M, surface=ground).near_m
    np.testing.assert_array_equal(clearance[COUNTED, SURFACE], clearance[COUNTED, GROUND])
    assert np.isinf(compute_clearances(GEOMETRY, AT_READY, FAR_M).near_m[:, SURFACE]).all()


def test_what_is_clear_of_a_surface_is_clear_of_a_plane_in_mujoco():
    spec = build(World())
    plane = spec.worldbody.add_geom(
        name="plane", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), contype=2, conaffinity=1
    )
    # a geom in the frame of its body would stay there
    plane.pos, plane.quat = (1, 1, 1), (0.8, 0.6, 0, 0)
    for geom in spec.geoms:
        geom.margin = FAR_M
    plant = Plant(spec.compile())
    model, data, plane = plant.model, plant.data, plant.model.geom("plane").id
    poses = in_limits(CONFIG, np.random.default_rng(4), 40)
    at_rest = settle_output(CONFIG.arm, poses, MARS_R_m_s2)
    for k, surface in enumerate(random_surfaces(5, 40)):
        model.geom_pos[plane] = FLIP * (surface.p_R_m + P_NR_M)
        mujoco.mju_quatZ2Vec(model.geom_quat[plane], FLIP * surface.normal_R)
        plant.show(poses[:, k], at_rest.strain[:, :, k])
        mujoco.mj_collision(model, data)
        frames = settle_output(CONFIG.arm, poses[:, k : k + 1], MARS_R_m_s2).frames
        ours = heights(frames, surface)
        touched = [contact for contact in data.contact if plane in contact.geom]
        assert touched
        for contact in touched:
            part = part_of(model, int(contact.geom[contact.geom != plane][0]))
            if PARTS.index(part) in COUNTED:
                assert ours[PARTS.index(part), 0] <= contact.dist + 1e-5


def test_the_rock_ends_half_way_to_a_part_that_starts_below_its_surface():
    X_RT = tool_pose(CONFIG.arm, AT_READY, "apxs")
    above = TargetSurface(X_RT.p[:, 0] - 0.6 * UP, UP, radius_m=0.65)
    far_below = replace(above, p_R_m=above.p_R_m + 1.2 * UP)
    assert limit_surface(GEOMETRY, AT_READY, above).radius_m == 0.65
    limited = limit_surface(GEOMETRY, AT_READY, far_below)
    assert 0.1 <= limited.radius_m < 0.65
    assert heights(AT_READY, limited)[COUNTED].min() >= 0.0


@pytest.mark.parametrize(("touching", "said"), [("apxs", None), (None, "would be 2 mm below the surface")])
def test_only_a_touching_tool_may_start_below_the_surface(touching, said):
    X_RT = tool_pose(CONFIG.arm, AT_READY, "apxs")
    normal = -X_RT.R[:, 0, 0]
    found = find_violation(
        GEOMETRY, AT_READY, PADDING_M, touching, TargetSurface(X_RT.p[:, 0] + 0.002 * normal, normal, 0.65)
    )
    assert (found.reason if found else None) == (f"the APXS {said}" if said else None)
