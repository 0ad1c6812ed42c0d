"""Closed-form estimate of base and target, and poses that do not determine them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.serial_synthetic import built_arm, drawn_arm, series, setup
from simgap.common.errors import RobotError
from simgap.serial_arm.calibrate import estimate_setup
from simgap.serial_arm.chain import Pose


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_base_and_target_are_exact(seed):
    arm = drawn_arm()
    stands = setup(seed)
    found = estimate_setup(arm, series(arm, stands, 50, seed, noise=0.0))
    for one, other in ((found.X_TB, stands.X_TB), (found.X_FM, stands.X_FM)):
        np.testing.assert_allclose(one.R, other.R, atol=1e-12)
        np.testing.assert_allclose(one.p, other.p, atol=1e-12)


def measured():
    arm = drawn_arm()
    return arm, series(built_arm(arm, 1), setup(2), 100, 3)


def refused(arm, poses):
    with pytest.raises(RobotError) as error:
        estimate_setup(arm, poses)
    return str(error.value)


def test_few_poses_are_refused_with_how_many_would_be_enough():
    arm, poses = measured()
    assert refused(arm, poses.at(np.arange(19))) == "19 poses are too few; 20 or more are wanted"


def test_poses_that_are_all_alike_are_refused():
    arm, poses = measured()
    same = replace(poses.at(np.zeros(100, int)), row=poses.row)
    assert "too much alike" in refused(arm, same)


def test_poses_that_turn_about_one_axis_only_are_refused():
    arm, poses = measured()
    q = np.zeros_like(poses.joint_rad)
    q[0] = poses.joint_rad[0]
    assert "second axis" in refused(arm, replace(poses, joint_rad=q))


def test_a_wrong_unit_of_positions_is_named_by_its_factor():
    arm, poses = measured()
    in_mm = replace(poses, X_TM=Pose(poses.X_TM.R, poses.X_TM.p * 1e3))
    assert "times as far: see that positions have their unit" in refused(arm, in_mm)


def test_angles_in_a_wrong_order_are_told_from_an_arm_s_errors():
    arm, poses = measured()
    angles = Rotation.from_matrix(np.moveaxis(poses.X_TM.R, -1, 0)).as_euler("XYZ")
    R = np.moveaxis(Rotation.from_euler("ZYX", angles).as_matrix(), 0, -1)
    assert "rotations the order that the tracker means" in refused(
        arm, replace(poses, X_TM=Pose(R, poses.X_TM.p))
    )


def test_joints_in_degrees_are_refused():
    arm, poses = measured()
    assert "angles have their units" in refused(arm, replace(poses, joint_rad=np.degrees(poses.joint_rad)))


def test_another_arm_is_refused():
    arm, poses = measured()
    links = tuple(replace(one, a_m=one.a_m + 0.3) for one in arm.links)
    assert "see that this is the arm of the file" in refused(replace(arm, links=links), poses)
