"""Poses of processes: the deflected arm has gravity in the commanded direction of the tool."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import Config
from fsw.dictionary.commands import Process
from fsw.dictionary.enums import Joint
from fsw.executive.poses import find_gravity_pose
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.motion.plan import Refusal
from helpers.marks import slow_but
from tests.fsw.rig import Rig, config_of, floats, in_limits
from tests.tools import TOOLS

CONFIG = config_of()


def tilted(rng: np.random.Generator, most_rad: float) -> np.ndarray:
    """Return the gravity of Mars on a rover with a random tilt of at most `most_rad`."""
    tilt, heading = rng.uniform(0, most_rad), rng.uniform(-np.pi, np.pi)
    return 3.711 * np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])


def down_in(config: Config, output_rad: np.ndarray, gravity: np.ndarray, tool: str) -> np.ndarray:
    """Compute the direction of gravity in a tool of the deflected arm."""
    R_RT = tool_pose(config.arm, settle_output(config.arm, output_rad, gravity).frames, tool).R
    return R_RT.T @ gravity / np.linalg.norm(gravity)


@pytest.mark.parametrize(
    "arm", slow_but(["nominal", *(f"calibrated:{seed}" for seed in range(1, 9))], "nominal", "calibrated:3")
)
def test_what_wrist_and_turret_can_bring_about_is_found_exactly_whether_the_arm_is_square_or_not(arm):
    """Starts and gravities are random; the direction is that of another wrist and turret angle."""
    config = config_of(arm)
    rng = np.random.default_rng([*arm.encode(), 80])
    rig = Rig(config)
    for start, other in zip(in_limits(config, rng, 20).T, in_limits(config, rng, 20).T, strict=True):
        gravity = tilted(rng, np.radians(30.0)) * rng.choice([1.0, 9.81 / 3.711])
        joints = replace(rig.state.joints, motor_rad=start, imu_R_m_s2=gravity)
        there = np.append(joints.output_rad[: Joint.WRIST], other[Joint.WRIST :])
        tool = TOOLS[rng.integers(5)]
        wanted = down_in(config, there, gravity, tool)
        answer = find_gravity_pose(config, joints, Process(tool, floats(wanted), 1.0))
        assert not isinstance(answer, Refusal), answer.reason
        assert np.linalg.norm(down_in(config, answer, gravity, tool) - wanted) < 1e-9
        np.testing.assert_array_equal(answer[: Joint.WRIST], joints.output_rad[: Joint.WRIST])
        assert np.all(answer >= config.arm.soft_min_rad)
        assert np.all(answer <= config.arm.soft_max_rad)


@pytest.mark.parametrize("arm", slow_but(["nominal", "calibrated:1"], "calibrated:1"))
def test_what_is_refused_is_out_of_reach_of_the_wrist_or_beyond_a_limit(arm):
    config = config_of(arm)
    rng = np.random.default_rng([*arm.encode(), 81])
    rig = Rig(config)
    held = 0
    for pose in in_limits(config, rng, 40, shrink=0.05).T:
        gravity = tilted(rng, np.radians(20.0))
        joints = replace(rig.state.joints, motor_rad=pose, imu_R_m_s2=gravity)
        wanted, tool = rng.standard_normal(3), TOOLS[rng.integers(5)]
        answer = find_gravity_pose(config, joints, Process(tool, floats(wanted), 1.0))
        if isinstance(answer, Refusal):
            assert "the wrist can bring it to" in answer.reason or "is outside" in answer.reason
            continue
        held += 1
        assert np.linalg.norm(down_in(config, answer, gravity, tool) - wanted / np.linalg.norm(wanted)) < 1e-9
    assert held > 15


def test_what_the_wrist_cannot_do_with_this_azimuth_is_refused_with_what_it_can():
    rig = Rig(CONFIG)
    gravity = 3.711 * np.array([0.0, np.sin(0.3), np.cos(0.3)])
    joints = replace(rig.state.joints, imu_R_m_s2=gravity)
    axis_T = CONFIG.arm.X_FT["portion"].R[2]
    answer = find_gravity_pose(CONFIG, joints, Process("portion", floats(axis_T), 1.0, deflection="off"))
    assert isinstance(answer, Refusal)
    assert "with this azimuth the wrist can bring it to 17.2 .. 162.8 deg" in answer.reason
    wrist = np.linspace(-np.pi, np.pi, 721)
    poses = np.tile(joints.output_rad[:, None], wrist.size)
    poses[Joint.WRIST] = wrist
    along = forward(CONFIG.arm, poses).X_RF.R[:, 2, 5].T @ gravity / np.linalg.norm(gravity)
    np.testing.assert_allclose(np.degrees(np.arccos([along.max(), along.min()])), [17.2, 162.8], atol=0.1)
