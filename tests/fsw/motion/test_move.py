"""Moves: their phases, and how wrist and turret process a sample."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import Config
from fsw.dictionary.commands import Process
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandCompleted
from fsw.estimate.joints import no_load
from fsw.executive.poses import find_gravity_pose
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.motion.move import (
    ALL_JOINTS,
    Move,
    MovePlan,
    Phase,
    advance_move,
    command_actuators,
    stop_early,
)
from fsw.motion.paths import Setpoint, StopPath, joint_path
from fsw.motion.plan import Refusal
from helpers.marks import slow_but
from tests.fsw.rig import Rig, config_of, floats, in_limits, quiet_sensors
from tests.tools import TOOLS

CONFIG = config_of()
READY = np.array(CONFIG.params.poses.ready_rad)
NO_LOAD = no_load(5)
SENSORS = quiet_sensors(np.zeros(5))


def move_by(angle_rad: float, phase: Phase = Phase.RELEASE, **fields) -> Move:
    path = joint_path(CONFIG, READY, READY + angle_rad)
    plan = MovePlan("MoveJoints", Mode.DEPLOYED, **({"active": ALL_JOINTS, "paths": (path,)} | fields))
    return Move(plan, Setpoint(READY, np.zeros(5)), CONFIG.current_limit_A, phase)


AT_READY = Rig(CONFIG).state.joints


def following(move):
    """Return joints that are at the set-point."""
    return replace(AT_READY, motor_rad=move.setpoint.motor_rad, motor_rate_rad_s=move.setpoint.rate_rad_s)


def advance(move, joints=None):
    """Run a cycle of a move; the joints follow if nothing else is said."""
    return advance_move(CONFIG, move, following(move) if joints is None else joints, NO_LOAD, SENSORS)


def run_through(move):
    """Run a move to its end; return the move in each cycle, and the last result."""
    moves = []
    while move is not None:
        moves.append(move)
        result = advance(move)
        move = result.move
        assert len(moves) < 2000
    return moves, result


def test_the_phases_follow_one_another_to_the_end_and_the_set_point_goes_along_the_path_without_a_jump():
    moves, result = run_through(move_by(0.02))
    phases = [move.phase for move in moves]
    assert phases == sorted(phases)
    assert set(phases) == set(Phase)
    assert result.evrs == (CommandCompleted("MoveJoints"),)
    assert result.end_mode is Mode.DEPLOYED
    seen = np.array([move.setpoint.motor_rad for move in moves])
    np.testing.assert_array_equal(seen[0], READY)
    np.testing.assert_allclose(seen[-1], READY + 0.02, atol=1e-12)
    assert (np.abs(np.diff(seen, axis=0)) <= CONFIG.speed_rad_s / 64 * (1 + 1e-9)).all()


@pytest.mark.parametrize("phase", Phase)
def test_a_stop_in_any_phase_ends_early_and_forgets_the_contact(phase):
    stopped = stop_early(CONFIG, move_by(0.5, phase, guarded_tool="apxs"), Mode.GUARDED)
    assert stopped.plan.stopped
    assert stopped.plan.guarded_tool is None
    assert stopped.plan.end_mode is Mode.GUARDED
    expected = {Phase.RELEASE: Phase.BRAKE}.get(phase, phase)
    assert stopped.phase is expected
    if phase is Phase.RUN:
        (path,) = stopped.plan.paths
        assert isinstance(path, StopPath)


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("joint", Joint)
def test_the_joints_that_a_move_does_not_take_stay_braked_without_power(phase, joint):
    rig, alone = Rig(CONFIG), np.arange(5) == joint
    move = move_by(0.1, phase, active=alone)
    drive = command_actuators(CONFIG, move, rig.state.joints, rig.state.drive)
    np.testing.assert_array_equal(drive.power_on, alone)
    np.testing.assert_array_equal(drive.brake_release, alone & (phase is not Phase.BRAKE))


def test_set_points_are_the_counts_nearest_to_the_angle():
    rig = Rig(CONFIG)
    move = replace(move_by(0.1), setpoint=Setpoint(READY + 1e-4, np.zeros(5)))
    drive = command_actuators(CONFIG, move, rig.state.joints, rig.state.drive)
    back = drive.setpoint_count * CONFIG.rad_per_count + rig.state.joints.reference.zero_rad
    assert (np.abs(back - READY - 1e-4) <= CONFIG.rad_per_count / 2 * (1 + 1e-6)).all()


def test_calm_is_counted_anew_after_the_last_motion():
    move = move_by(0.0, phase=Phase.SETTLE)
    calm = following(move)
    for upset in (0, 3):
        settling, cycles = move, 0
        for joints in [calm] * upset + [replace(calm, motor_rad=calm.motor_rad + 1e-3)]:
            settling = advance(settling, joints).move
        while settling.phase is Phase.SETTLE:
            settling, cycles = advance(settling, calm).move, cycles + 1
        assert cycles == CONFIG.settle_ticks


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
