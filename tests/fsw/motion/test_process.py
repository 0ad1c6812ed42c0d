"""Holding the turret against gravity: what is asked for is what the hanging arm then does."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import Process
from fsw.dictionary.joints import Joint, Tool
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import rest
from fsw.motion.plan import Refusal
from fsw.motion.plan_process import gravity_pose
from tests.fsw.rig import Rig, config_of, floats, in_limits

CONFIG = config_of()


def tilted(rng: np.random.Generator, most_rad: float) -> np.ndarray:
    """Gravity of Mars on a rover tilted any way by up to so much."""
    tilt, heading = rng.uniform(0, most_rad), rng.uniform(-np.pi, np.pi)
    return 3.711 * np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])


@pytest.mark.parametrize("seed", range(4))
def test_gravity_lies_along_the_direction_in_the_tool_of_the_hanging_arm(seed):
    rng = np.random.default_rng([seed, 80])
    rig = Rig(CONFIG)
    held = 0
    for pose in in_limits(CONFIG, rng, 40, shrink=0.05).T:
        gravity = tilted(rng, np.radians(20.0))
        joints = replace(rig.state.joints, motor_rad=pose, imu_R_m_s2=gravity)
        wanted, tool = rng.standard_normal(3), Tool(int(rng.integers(len(Tool))))
        answer = gravity_pose(CONFIG, joints, Process(tool, floats(wanted), 1.0))
        if isinstance(answer, Refusal):
            continue
        held += 1
        hanging = tool_pose(CONFIG.arm, rest(CONFIG.arm, answer, gravity).frames, tool).R
        down_T = hanging.T @ gravity / np.linalg.norm(gravity)
        assert np.linalg.norm(down_T - wanted / np.linalg.norm(wanted)) < 1e-5
        np.testing.assert_array_equal(answer[: Joint.WRIST], joints.output_rad[: Joint.WRIST])
        assert np.all(answer >= CONFIG.arm.soft_min_rad)
        assert np.all(answer <= CONFIG.arm.soft_max_rad)
    assert held > 15


def test_what_the_wrist_cannot_do_with_this_azimuth_is_refused_with_what_it_can():
    rig = Rig(CONFIG)
    gravity = 3.711 * np.array([0.0, np.sin(0.3), np.cos(0.3)])
    joints = replace(rig.state.joints, imu_R_m_s2=gravity)
    axis_T = CONFIG.arm.X_FT[Tool.PORTION].R[2]
    answer = gravity_pose(CONFIG, joints, Process(Tool.PORTION, floats(axis_T), 1.0, deflection="off"))
    assert isinstance(answer, Refusal)
    assert "with this azimuth the wrist can bring it to 17.2 .. 162.8 deg" in answer.reason
    wrist = np.linspace(-np.pi, np.pi, 721)
    poses = np.tile(joints.output_rad[:, None], wrist.size)
    poses[Joint.WRIST] = wrist
    along = forward(CONFIG.arm, poses).X_RF.R[:, 2, 5].T @ gravity / np.linalg.norm(gravity)
    np.testing.assert_allclose(np.degrees(np.arccos([along.max(), along.min()])), [17.2, 162.8], atol=0.1)
