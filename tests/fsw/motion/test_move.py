"""Moves: their phases, how wrist and turret process a sample, and their paths from rest to rest."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.config import CYCLE_S, Config
from fsw.dictionary.commands import GuardedMove, Process, Retract
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandCompleted
from fsw.estimate.joints import no_load
from fsw.executive.poses import find_gravity_pose
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.motion.move import ALL_JOINTS, Move, MovePlan, Phase, advance_move, command_actuators, stop_early
from fsw.motion.paths import LinePath, Setpoint, StopPath, Travel, joint_path, line_path, stop_path
from fsw.motion.plan import Plan, Refusal
from fsw.motion.plan_tool import plan_guarded, plan_retract
from fsw.motion.work import complete
from helpers.marks import slow_but
from tests.fsw.motion.lab import along, likely, sampled
from tests.fsw.rig import (
    Rig,
    config_of,
    facing,
    floats,
    in_limits,
    in_the_open,
    planned,
    quiet_sensors,
    with_params,
)
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


def test_the_phases_follow_one_another_to_the_end_and_the_set_point_goes_along_the_path_without_a_jump():
    moves, move = [], move_by(0.02)
    while move is not None:
        moves.append(move)
        result = advance(move)
        move = result.move
        assert len(moves) < 2000
    phases = [move.phase for move in moves]
    assert phases == sorted(phases)
    assert set(phases) == set(Phase) - {Phase.PLAN}
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
    expected = {Phase.RELEASE: Phase.BRAKE, Phase.PLAN: Phase.SETTLE}.get(phase, phase)
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
        answer = complete(config, find_gravity_pose(joints, Process(tool, floats(wanted), 1.0)))
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
    command = Process("portion", floats(axis_T), 1.0, deflection="off")
    answer = complete(CONFIG, find_gravity_pose(joints, command))
    assert isinstance(answer, Refusal)
    assert "with this azimuth the wrist can bring it to 17.2 .. 162.8 deg" in answer.reason
    wrist = np.linspace(-np.pi, np.pi, 721)
    poses = np.tile(joints.output_rad[:, None], wrist.size)
    poses[Joint.WRIST] = wrist
    along = forward(CONFIG.arm, poses).X_RF.R[:, 2, 5].T @ gravity / np.linalg.norm(gravity)
    np.testing.assert_allclose(np.degrees(np.arccos([along.max(), along.min()])), [17.2, 162.8], atol=0.1)


WIND_UP_RAD = CONFIG.output_friction_Nm / CONFIG.arm.gear_stiffness_Nm_rad
STOP_FACTOR = CONFIG.params.motion.stop_factor
STRAIGHT_M = 20e-6
AXIS_RAD = 20e-6
STEP_M = 1e-6
"""Largest step of the tool between the end of one path of a plan and the start of the next."""

poses = st.integers(0, 2**32 - 1).map(lambda seed: in_limits(CONFIG, np.random.default_rng(seed), 2).T)


@settings(max_examples=30)
@given(poses)
def test_a_joint_move_goes_from_rest_to_rest_within_speed_and_acceleration_and_never_turns_back(pair):
    path = joint_path(CONFIG, *pair)
    for time, pose in ((0.0, pair[0]), (path.duration_s, pair[1]), (path.duration_s + 5, pair[1])):
        np.testing.assert_allclose(path.at(time).motor_rad, pose, atol=1e-9)
        np.testing.assert_allclose(path.at(time).rate_rad_s, 0, atol=1e-9)
    times, angle, rate = sampled(path)
    assert (np.abs(rate) <= CONFIG.speed_rad_s * (1 + 1e-9)).all()
    acceleration = np.diff(rate, axis=0) / np.diff(times)[:, None]
    assert (np.abs(acceleration) <= CONFIG.acceleration_rad_s2 * (1 + 1e-6)).all()
    assert (np.diff(angle, axis=0) * np.sign(pair[1] - pair[0]) >= -1e-12).all()
    assert (angle >= pair.min(axis=0) - 1e-9).all()
    assert (angle <= pair.max(axis=0) + 1e-9).all()


def line(length_m: float) -> Travel:
    """Return the travel of a straight move with the speed of a guarded one."""
    motion = CONFIG.params.motion
    return Travel(length_m, 0.005, motion.line_acceleration_m_s2, motion.line_jerk_m_s3)


def test_all_joints_of_a_move_end_together():
    start = np.array(CONFIG.params.poses.ready_rad)
    path = joint_path(CONFIG, start, start + np.array([0.02, 0.5, 0.1, 0.05, 0.3]))
    before_end = path.at(path.duration_s - 0.5).rate_rad_s
    assert (before_end > 0).all()
    alone = joint_path(CONFIG, start, start + np.array([0.0, 0.5, 0.0, 0.0, 0.0]))
    assert path.duration_s == pytest.approx(alone.duration_s)


@given(hnp.arrays(float, 5, elements=st.floats(-1, 1)), hnp.arrays(float, 5, elements=st.floats(-3, 3)))
def test_a_stop_begins_where_the_move_was_and_slows_every_joint_to_rest(share, angle):
    start = Setpoint(angle, share * CONFIG.speed_rad_s)
    path = stop_path(CONFIG, start)
    times, angles, rates = sampled(path, 50)
    np.testing.assert_allclose(angles[0], start.motor_rad, atol=1e-12)
    np.testing.assert_allclose(rates[0], start.rate_rad_s, atol=1e-12)
    np.testing.assert_allclose(path.at(path.duration_s + 1).rate_rad_s, 0, atol=1e-15)
    assert (np.diff(np.abs(rates), axis=0) <= 1e-15).all()
    assert (rates * np.sign(start.rate_rad_s) >= -1e-15).all()
    if path.duration_s > CYCLE_S:
        deceleration = np.abs(np.diff(rates, axis=0)) / np.diff(times)[:, None]
        assert (deceleration <= STOP_FACTOR * CONFIG.acceleration_rad_s2 * (1 + 1e-6)).all()
    step = np.diff(angles, axis=0)
    mean_rate = (rates[1:] + rates[:-1]) / 2 * np.diff(times)[:, None]
    np.testing.assert_allclose(step, mean_rate, atol=1e-12)


@pytest.mark.parametrize("factor", [1.0, 10.0])
def test_a_stop_takes_the_time_that_its_factor_and_the_slowest_joint_need(factor):
    config = with_params(motion={"stop_factor": factor})
    path = stop_path(config, Setpoint(np.zeros(5), config.speed_rad_s))
    slowest_s = (config.speed_rad_s / config.acceleration_rad_s2).max() / factor
    assert path.duration_s == pytest.approx(max(slowest_s, CYCLE_S), rel=1e-12)


def straight(plan) -> LinePath:
    assert isinstance(plan, Plan)
    (path,) = plan.paths
    assert isinstance(path, LinePath)
    return path


def line_errors(X):
    """Compute the errors of a line: distance from its chord, turn of the axis, and length."""
    p, axis = X.p.T, X.R[:, 0].T
    start, end = p[0], p[-1]
    chord = (end - start) / np.linalg.norm(end - start)
    offset = p - start
    offset = offset - np.outer(offset @ chord, chord)
    turn = np.arccos(np.clip(axis @ axis[0], -1, 1))
    return np.linalg.norm(offset, axis=1).max(), turn.max(), float(np.linalg.norm(end - start))


CROSSING = [
    one
    for one in product(TOOLS, ("guarded", "retract"), ("facing", "ready"))
    # in the ready pose the drill is parallel to the pitch axes: no line starts there
    if (one[0], one[2]) != ("drill", "ready")
]


@pytest.mark.parametrize(("tool", "kind", "start"), slow_but(CROSSING, *CROSSING[2:6]))
def test_a_line_is_straight_also_where_gaps_are_crossed_and_the_crossing_leaves_the_tool_where_it_was(
    tool, kind, start
):
    """A separate joint move crosses the backlash while the outputs rest; then the line continues."""
    rig = Rig(CONFIG, start_rad=facing(CONFIG, tool) if start == "facing" else None)
    joints, begin = rig.state.joints, rig.tool_pose(tool)
    if kind == "guarded":
        plan = planned(CONFIG, plan_guarded(CONFIG, joints, rig.touch(tool, 0.12)))
    else:
        plan = planned(CONFIG, plan_retract(CONFIG, joints, Retract(tool, 0.1)))
    assert isinstance(plan, Plan)
    there = begin.p + (0.12 if kind == "guarded" else -0.1) * begin.R[:, 0]
    way = (there - begin.p) / np.linalg.norm(there - begin.p)
    here, gear, length = begin.p, likely(joints), 0.0
    for path in plan.paths:
        X, gear = along(CONFIG, tool, path, gear)
        np.testing.assert_allclose(X.p[:, 0], here, atol=STEP_M)
        off = X.p - begin.p[:, None]
        assert np.linalg.norm(off - np.outer(way, way @ off), axis=0).max() < STRAIGHT_M
        if isinstance(path, LinePath):
            off_m, turn_rad, piece_m = line_errors(X)
            assert off_m < STRAIGHT_M
            assert turn_rad < AXIS_RAD
            length += piece_m
        else:
            # the motor crosses backlash and wind-up while the output rests
            np.testing.assert_allclose(X.p, np.tile(here[:, None], X.p.shape[1]), atol=STEP_M)
            crossed = np.abs(path.at(path.duration_s).motor_rad - path.at(0.0).motor_rad)
            assert (crossed <= 2 * (CONFIG.half_backlash_rad + WIND_UP_RAD) + 1e-9).all()
        here = X.p[:, -1]
    np.testing.assert_allclose(here, there, atol=1e-6)
    np.testing.assert_allclose(gear, plan.end.gear_rad, atol=1e-9)
    np.testing.assert_allclose(path.at(path.duration_s).motor_rad, plan.end.motor_rad, atol=1e-12)
    assert length == pytest.approx(np.linalg.norm(there - begin.p), abs=2e-5)


def test_a_line_may_turn_the_tool_to_its_approach_on_the_way():
    bare = replace(config_of("nominal"), half_backlash_rad=np.zeros(5), output_friction_Nm=np.zeros(5))
    config = in_the_open(bare)  # so that only the geometry remains
    rig = Rig(config)
    X = rig.tool_pose("apxs")
    approach = X.R[:, 0] + 0.02 * X.R[:, 1]
    command = GuardedMove("apxs", floats(X.p + 0.1 * X.R[:, 0]), floats(approach))
    path = straight(planned(config, plan_guarded(config, rig.state.joints, command)))
    end, _ = along(config, "apxs", path, likely(rig.state.joints))
    np.testing.assert_allclose(end.R[:, 0, -1], approach / np.linalg.norm(approach), atol=1e-7)


@pytest.mark.parametrize("tool", TOOLS)
def test_a_line_runs_from_rest_to_rest_no_faster_than_told_and_no_joint_above_its_speed(tool):
    rig = Rig(CONFIG, start_rad=facing(CONFIG, tool))
    plan = planned(CONFIG, plan_guarded(CONFIG, rig.state.joints, rig.touch(tool, 0.15)))
    np.testing.assert_allclose(plan.paths[0].at(0.0).motor_rad, rig.state.joints.motor_rad, atol=1e-12)
    for path in (one for one in plan.paths if isinstance(one, LinePath)):
        times, angle, rate = sampled(path, 600)
        np.testing.assert_allclose(rate[[0, -1]], 0, atol=1e-9)
        assert (np.abs(rate) <= CONFIG.speed_rad_s * (1 + 1e-9)).all()
        speed = np.array([path.travel_at(t)[1] for t in times])
        assert speed.max() <= CONFIG.params.motion.guarded_speed_m_s * (1 + 1e-9)
        numeric = np.gradient(angle, times, axis=0)
        np.testing.assert_allclose(numeric[2:-2], rate[2:-2], atol=2e-5)


@given(st.integers(0, 2**32 - 1), st.integers(2, 9))
def test_no_joint_is_above_its_speed_on_any_knots(seed, count):
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.normal(0, 10.0 ** rng.uniform(-4, -1), (count, 5)), axis=0)
    path = line_path(CONFIG, knots, line(0.01 * (count - 1)))
    _, _, rate = sampled(path, 1000)
    assert (np.abs(rate) <= CONFIG.speed_rad_s * (1 + 1e-9)).all()


def test_a_joint_at_the_end_of_its_speed_slows_the_line():
    knots = np.linspace(np.zeros(5), np.array([0, 0, 0, 0, 1.0]), 11)
    path = line_path(CONFIG, knots, line(0.01))
    _, _, rate = sampled(path)
    assert np.abs(rate).max() == pytest.approx(CONFIG.speed_rad_s[4], rel=1e-6)
