"""Poses of the hardstop initialisation: clear of everything, with low loads that are equal on two planets."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.params import Params
from fsw.executive.poses import homing_start_poses
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
from sim.arms import arm_named, without_turret
from sim.clearance import ClearanceModel
from sim.world import World

NOMINAL = arm_named("nominal")
WHOLE = NOMINAL.params
MARS, EARTH = World(), World("earth")


@pytest.fixture(scope="module")
def bare() -> Params:
    return without_turret(NOMINAL, on_earth=True).params


def path_to_hardstop(params: Params, joint: Joint, pose_rad: np.ndarray) -> np.ndarray:
    """Return the path of a joint from a pose to its hardstop, (5, n)."""
    stop_rad = params.joints.in_order()[joint].hardstop_rad
    poses = np.repeat(pose_rad[:, None], 12, axis=1)
    poses[joint] = np.linspace(stop_rad, pose_rad[joint], 12)
    return poses


def test_the_order_has_every_joint_once() -> None:
    assert sorted(HARDSTOP_ORDER) == list(Joint)


@pytest.mark.parametrize(("world", "whole"), [(MARS, True), (EARTH, False)], ids=["mars", "earth"])
def test_on_the_whole_way_the_arm_is_clear_of_rover_ground_and_itself(world, whole, bare) -> None:
    params = WHOLE if whole else bare
    space = ClearanceModel(params, world)
    found = sweep_clearance(params, space)
    assert min(found.outside_m, found.self_m) > 2 * HARDSTOP_CLEARANCE_M


@pytest.mark.parametrize(("world", "whole"), [(MARS, True), (EARTH, False)], ids=["mars", "earth"])
@pytest.mark.parametrize("joint", Joint)
def test_a_joint_has_room_to_run_wherever_it_is_allowed_to(joint, world, whole, bare) -> None:
    params = WHOLE if whole else bare
    space, most = ClearanceModel(params, world), params.hardstop.pose_tolerance_rad
    rng = np.random.default_rng([15, joint])
    for pose in homing_start_poses(params, joint):
        for _ in range(20):
            found = space.clearance(path_to_hardstop(params, joint, pose + rng.uniform(-most, most, 5)))
            assert min(found.outside_m, found.self_m) > HARDSTOP_CLEARANCE_M


def test_the_way_goes_to_every_hardstop(bare) -> None:
    for params in (WHOLE, bare):
        stops = [joint.hardstop_rad for joint in params.joints.in_order()]
        np.testing.assert_allclose(sweep_poses(params).min(axis=1), stops)


def test_gravity_presses_gently_on_every_hardstop_or_not_at_all() -> None:
    torques = compute_hardstop_loads(WHOLE, MARS.gravity_N_m_s2).torque_Nm
    press = np.array([joint.hardstop_press_Nm for joint in WHOLE.joints.in_order()])
    friction = np.array([joint.output_friction_Nm for joint in WHOLE.joints.in_order()])
    assert np.all(torques < friction)
    assert np.all(torques > -0.6 * press)


def test_the_torques_are_the_same_on_earth_without_a_turret(bare) -> None:
    mars = compute_hardstop_loads(WHOLE, MARS.gravity_N_m_s2).torque_Nm
    earth = compute_hardstop_loads(bare, EARTH.gravity_N_m_s2).torque_Nm
    np.testing.assert_allclose(earth, mars, atol=LOAD_TOLERANCE_NM + 0.6)
    np.testing.assert_allclose(
        earth[list(EQUALISED_JOINTS)], mars[list(EQUALISED_JOINTS)], atol=LOAD_TOLERANCE_NM
    )


def test_in_the_poses_of_mars_they_are_others() -> None:
    params = without_turret(NOMINAL, on_earth=False).params
    mars = compute_hardstop_loads(WHOLE, MARS.gravity_N_m_s2).torque_Nm
    earth = compute_hardstop_loads(params, EARTH.gravity_N_m_s2).torque_Nm
    assert np.abs(earth - mars).max() > 50


def test_torques_that_no_pose_has_are_refused(bare) -> None:
    with pytest.raises(NoPlan, match="best torques differ"):
        equalise_loads(bare, EARTH.gravity_N_m_s2, np.full(5, -2000.0))


def test_the_turret_that_is_not_there_is_known_to_be_gone() -> None:
    arm = without_turret(NOMINAL, on_earth=True)
    assert arm.params.links.arm6.far.mass_kg == 0.0
    assert replace(arm.params.links.arm6, far=WHOLE.links.arm6.far) == WHOLE.links.arm6
