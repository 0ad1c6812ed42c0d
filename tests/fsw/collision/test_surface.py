"""Clearances of the arm to the surface of a target, with the ground and MuJoCo's plane as references."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fsw.collision.distance import UP, compute_clearances, limit_surface
from fsw.collision.geometry import GROUND, SURFACE, SURFACE_FRAME, TargetSurface
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from sim.frames import FLIP, P_NR_M
from sim.plant import Plant
from sim.setting import World
from sim.world import build
from tests.fsw.collision.mujoco_reference import part_of
from tests.fsw.rig import MARS_R_m_s2, beside_the_rover, find_violation, in_limits

CONFIG = beside_the_rover()
GEOMETRY = CONFIG.collision_geometry
PARTS, PADDING_M = GEOMETRY.parts, CONFIG.params.collision.padding_m
COUNTED = [k for k in range(len(PARTS)) if GEOMETRY.arm.carrier[GEOMETRY.arm.part == k][0] >= SURFACE_FRAME]
FAR_M = 10.0
READY = forward(CONFIG.arm, np.array(CONFIG.params.poses.ready_rad)[:, None])


def random_surfaces(seed, count):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    for normal, p in zip(normals, rng.uniform((1.0, -0.6, -0.2), (2.4, 0.6, 1.2), (count, 3)), strict=True):
        yield TargetSurface(p, normal / np.linalg.norm(normal))


def heights(frames, surface):
    return compute_clearances(GEOMETRY, frames, FAR_M, surface=surface)[:, SURFACE]


def test_level_ground_as_a_surface_has_the_distances_of_the_ground_to_the_last_bit():
    frames = forward(CONFIG.arm, in_limits(CONFIG, np.random.default_rng(1), 200))
    ground = TargetSurface(np.array([0.0, 0.0, GEOMETRY.ground_z_m]), UP)
    clearance = compute_clearances(GEOMETRY, frames, FAR_M, surface=ground)
    np.testing.assert_array_equal(clearance[COUNTED, SURFACE], clearance[COUNTED, GROUND])
    assert np.isinf(compute_clearances(GEOMETRY, READY, FAR_M)[:, SURFACE]).all()


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
    X_RT = tool_pose(CONFIG.arm, READY, "apxs")
    above = TargetSurface(X_RT.p[:, 0] - 0.6 * UP, UP, radius_m=0.65)
    far_below = replace(above, p_R_m=above.p_R_m + 1.2 * UP)
    assert limit_surface(GEOMETRY, READY, above).radius_m == 0.65
    limited = limit_surface(GEOMETRY, READY, far_below)
    assert 0.1 <= limited.radius_m < 0.65
    assert heights(READY, limited)[COUNTED].min() >= 0.0


@pytest.mark.parametrize(("touching", "said"), [("apxs", None), (None, "would be 2 mm below the surface")])
def test_only_a_touching_tool_may_start_below_the_surface(touching, said):
    X_RT = tool_pose(CONFIG.arm, READY, "apxs")
    normal = -X_RT.R[:, 0, 0]
    found = find_violation(
        GEOMETRY, READY, PADDING_M, touching, TargetSurface(X_RT.p[:, 0] + 0.002 * normal, normal, 0.65)
    )
    assert (found.reason if found else None) == (f"the APXS {said}" if said else None)
