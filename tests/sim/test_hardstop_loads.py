"""Poses of the hardstop initialisation: clear of everything, with low loads that are equal on two planets."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.params import Params
from fsw.executive.poses import homing_start_poses
from helpers.marks import slow_but
from sim.arm_check import (
    EQUALISED_JOINTS,
    HARDSTOP_CLEARANCE_M,
    LOAD_TOLERANCE_NM,
    NoPlan,
    compute_hardstop_loads,
    equalise_loads,
    sweep_clearance,
    sweep_poses,
)
from sim.arms import arm_named
from sim.bare_arm import without_turret
from sim.clearance import ClearanceModel
from sim.setting import World

MARS, EARTH = World(), World("earth")


ARMS = {name: arm_named(name) for name in ("nominal", "m2020")}
BARE = {name: without_turret(arm, on_earth=True) for name, arm in ARMS.items()}
PLACES = [*((arm, MARS) for arm in ARMS.values()), (BARE["nominal"], EARTH)]
EACH_PLACE = pytest.mark.parametrize(("arm", "world"), PLACES, ids=["mars", "m2020", "earth"])
EACH_ARM = pytest.mark.parametrize("name", ARMS)


def path_to_hardstop(params: Params, joint: Joint, pose_rad: np.ndarray) -> np.ndarray:
    """Return the path of a joint from a pose to its hardstop, (5, n)."""
    stop_rad = params.joints.in_order()[joint].hardstop_rad
    poses = np.repeat(pose_rad[:, None], 12, axis=1)
    poses[joint] = np.linspace(stop_rad, pose_rad[joint], 12)
    return poses


def test_the_order_has_every_joint_once() -> None:
    assert sorted(HARDSTOP_ORDER) == list(Joint)


@EACH_PLACE
def test_on_the_whole_way_to_every_hardstop_the_arm_is_clear_of_rover_ground_and_itself(arm, world):
    found = sweep_clearance(arm.params, ClearanceModel(arm.params, world, arm.model))
    assert min(found.outside_m, found.self_m) > 2 * HARDSTOP_CLEARANCE_M
    stops = [joint.hardstop_rad for joint in arm.params.joints.in_order()]
    np.testing.assert_allclose(sweep_poses(arm.params).min(axis=1), stops)


@EACH_PLACE
@pytest.mark.parametrize("joint", slow_but(Joint, Joint.ELEVATION, Joint.ELBOW))
def test_a_joint_has_room_to_run_wherever_it_is_allowed_to(joint, arm, world):
    space, most = ClearanceModel(arm.params, world, arm.model), arm.params.hardstop.pose_tolerance_rad
    rng = np.random.default_rng([15, joint])
    for pose in homing_start_poses(arm.params, joint):
        for _ in range(20):
            found = space.clearance(path_to_hardstop(arm.params, joint, pose + rng.uniform(-most, most, 5)))
            assert min(found.outside_m, found.self_m) > HARDSTOP_CLEARANCE_M


@EACH_ARM
def test_without_a_turret_on_earth_each_joint_is_clear_at_its_hardstop(name):
    params, model = BARE[name].params, BARE[name].model
    space = ClearanceModel(params, EARTH, model)
    for joint in Joint:
        pose = homing_start_poses(params, joint)[-1].copy()
        pose[joint] = params.joints.in_order()[joint].hardstop_rad
        found = space.clearance(pose[:, None])
        assert min(found.outside_m, found.self_m) > HARDSTOP_CLEARANCE_M


@EACH_ARM
def test_gravity_presses_gently_on_every_hardstop_or_not_at_all(name):
    params = ARMS[name].params
    torques, joints = compute_hardstop_loads(params, MARS.gravity_N_m_s2).torque_Nm, params.joints.in_order()
    assert np.all(torques < [joint.output_friction_Nm for joint in joints])
    assert np.all(torques > [-0.6 * joint.hardstop_press_Nm for joint in joints])


@EACH_ARM
def test_the_torques_are_the_same_on_earth_without_a_turret_and_others_in_the_poses_of_mars(name):
    in_mars_poses = without_turret(ARMS[name], on_earth=False).params
    mars = compute_hardstop_loads(ARMS[name].params, MARS.gravity_N_m_s2).torque_Nm
    earth, other = (
        compute_hardstop_loads(params, EARTH.gravity_N_m_s2).torque_Nm
        for params in (BARE[name].params, in_mars_poses)
    )
    same = list(EQUALISED_JOINTS)
    np.testing.assert_allclose(earth[same], mars[same], atol=LOAD_TOLERANCE_NM)
    if name == "nominal":
        np.testing.assert_allclose(earth, mars, atol=LOAD_TOLERANCE_NM + 0.6)
        assert np.abs(other - mars).max() > 50


def test_torques_that_no_pose_has_are_refused() -> None:
    with pytest.raises(NoPlan, match="best torques differ"):
        equalise_loads(BARE["nominal"].params, EARTH.gravity_N_m_s2, np.full(5, -2000.0))


def test_the_turret_that_is_not_there_is_known_to_be_gone() -> None:
    arm6, whole = (arms["nominal"].params.links.arm6 for arms in (BARE, ARMS))
    assert arm6.far.mass_kg == 0.0
    assert replace(arm6, far=whole.far) == whole
