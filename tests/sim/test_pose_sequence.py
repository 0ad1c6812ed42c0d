"""Pose sequences: flight software knows the flank of each joint, and compensates for it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fsw.config import Config, configure
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import joints5
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.transforms import Array
from sim.arms import arm_named
from sim.effects.faults import JointSeized
from sim.loop import ClosedLoop, Setup
from sim.pose_sequence import free_air_loop, pose_in_workspace, run_and_rest, usual_limits_rad
from sim.setting import World
from tests.sim import lab

pytestmark = pytest.mark.slow

ARM = arm_named("nominal")
FRICTION_NM = np.array([joint.output_friction_Nm for joint in ARM.params.joints.in_order()])
TILTED = World("mars", np.radians(15.0), np.radians(-20.0))
POSES = 6
MAX_STEP_RAD = 0.02


def random_poses(config: Config, rng: np.random.Generator, count: int) -> list[Array]:
    """Draw poses within the limits: in the workspace on any branch, near the last, or back."""
    poses, limits_rad = [np.array(config.params.poses.ready_rad)], usual_limits_rad(config)
    while len(poses) <= count:
        match rng.integers(10):
            case 0:
                poses.append(rng.uniform(*limits_rad))
            case 1 | 2:
                tools = config.params.tool_names
                tool = tools[int(rng.integers(len(tools)))]
                poses.append(pose_in_workspace(config, rng, tool, BRANCHES))
            case 3:
                poses.append(poses[-2] if len(poses) > 1 else poses[-1])
            case _:
                step = rng.uniform(-MAX_STEP_RAD, MAX_STEP_RAD, 5) * rng.integers(0, 2, 5)
                poses.append(np.clip(poses[-1] + step, *limits_rad))
    return poses[1:]


def visit(backlash: str, arm_name: str = "nominal", poses: int = POSES) -> list[Any]:
    """Return the states at rest after moves to random poses."""
    arm = arm_named(arm_name)
    goals = random_poses(configure(arm.params), np.random.default_rng(41), poses)
    loop = free_air_loop(Setup(arm, TILTED, arm.params.poses.ready_rad, 41, lab.true_reference(arm)))
    return [rest_at(loop, pose_rad, backlash) for pose_rad in goals]


def rest_at(loop: ClosedLoop, pose_rad: np.ndarray, backlash: str) -> Any:
    assert run_and_rest(loop, MoveJoints(joints5(pose_rad), backlash)) is None
    plant, joints, truth = loop.plant, loop.state.joints, loop.plant.truth()
    gear_rad = truth.output_rad - truth.motor_rad
    return SimpleNamespace(
        error_rad=truth.output_rad - pose_rad,
        side=joints.side,
        true_side=np.sign(gear_rad) * (np.abs(gear_rad) > 0.95 * plant.half_backlash_rad),
        gear_error_rad=gear_rad - (joints.output_rad - joints.motor_rad),
        uncertainty_rad=joints.uncertainty_rad,
        load_Nm=loop.state.load.torque_Nm,
    )


@pytest.fixture(scope="module")
def compensated() -> list[Any]:
    return visit("on")


@pytest.fixture(scope="module")
def uncompensated() -> list[Any]:
    return visit("off", poses=POSES // 2)


def error_rad(poses: list[Any]) -> np.ndarray:
    return np.array([pose.error_rad for pose in poses])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_a_side_that_is_claimed_is_the_side(compensated, uncompensated):
    for pose in (*compensated, *uncompensated, *visit("on", "as-built:6", poses=3)):
        known = pose.side != 0
        np.testing.assert_array_equal(pose.side[known], pose.true_side[known])


def test_it_is_claimed_wherever_the_load_decides_it_and_nearly_everywhere_else(compensated):
    sides = np.array([pose.side for pose in compensated])
    loaded = np.abs([pose.load_Nm for pose in compensated]) > FRICTION_NM
    assert np.mean(sides[loaded] != 0) > 0.95
    assert np.mean(sides == 0) < 0.05


def test_outputs_come_to_where_they_are_wanted(compensated, uncompensated):
    known = np.array([pose.side != 0 for pose in compensated])
    assert rms(error_rad(compensated)[known]) < 0.05e-3
    assert rms(error_rad(uncompensated)) > 1.5e-3


def test_what_is_believed_of_a_gear_is_true_within_its_uncertainty(compensated):
    for pose in compensated:
        assert np.all(np.abs(pose.gear_error_rad) < pose.uncertainty_rad + 0.05e-3)


def test_a_move_that_fails_is_told_with_the_fault_that_ended_it():
    loop = free_air_loop(Setup(ARM, World(), ARM.params.poses.ready_rad, 0, lab.true_reference(ARM)))
    loop = loop.fork((JointSeized(2.0, Joint.ELBOW),))
    goal = np.add(ARM.params.poses.ready_rad, (0.0, 0.0, 0.5, 0.0, 0.0))
    problem = run_and_rest(loop, MoveJoints(joints5(goal)))
    assert problem is not None
    assert "ELBOW" in problem
    assert problem.endswith("MoveJoints aborted")
