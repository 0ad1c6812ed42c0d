"""Moves from brake release to brakes on, phase by phase, and their commands to motors and brakes."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandCompleted
from fsw.estimate.joints import no_load
from fsw.motion.move import (
    ALL_JOINTS,
    Move,
    MovePlan,
    Phase,
    advance_move,
    command_actuators,
    find_closed_switch,
    stop_early,
)
from fsw.motion.paths import Setpoint, StopPath, joint_path
from fsw.state import boot
from tests.fsw.rig import Rig, config_of, quiet_sensors
from tests.tools import SWITCHES, TOOL_SWITCHES

CONFIG = config_of()
READY = np.array(CONFIG.params.poses.ready_rad)
NO_LOAD = no_load(5)
SENSORS = quiet_sensors(np.zeros(5))


def resting() -> Setpoint:
    return Setpoint(READY, np.zeros(5))


def move_by(angle_rad: float, phase: Phase = Phase.RELEASE, **fields) -> Move:
    path = joint_path(CONFIG, READY, READY + angle_rad)
    plan = MovePlan("MoveJoints", Mode.DEPLOYED, **({"active": ALL_JOINTS, "paths": (path,)} | fields))
    return Move(plan, resting(), CONFIG.current_limit_A, phase)


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


def test_paths_run_one_after_the_other_each_to_its_end():
    there, back = joint_path(CONFIG, READY, READY + 0.01), joint_path(CONFIG, READY + 0.01, READY)
    moves, _ = run_through(move_by(0.0, paths=(there, back)))
    assert max(move.setpoint.motor_rad[0] for move in moves) == pytest.approx(READY[0] + 0.01)
    np.testing.assert_allclose(moves[-1].setpoint.motor_rad, READY, atol=1e-12)


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


def test_a_tool_without_switches_never_touches():
    assert find_closed_switch(CONFIG, "portion", np.ones(10, bool)) is None
    for tool, switches in TOOL_SWITCHES.items():
        for switch in switches:
            assert find_closed_switch(CONFIG, tool, np.isin(SWITCHES, [switch])) == switch


def test_without_a_move_brakes_are_on_and_power_is_off():
    state = boot(CONFIG, Mode.DEPLOYED)
    drive = command_actuators(CONFIG, None, state.joints, state.drive)
    assert not drive.power_on.any()
    assert not drive.brake_release.any()


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


def test_a_stop_goes_on_from_the_set_point_without_a_jump():
    move = move_by(0.5)
    for _ in range(300):
        move = advance(move).move
    rate = move.setpoint.rate_rad_s
    braking = advance(stop_early(CONFIG, move, Mode.DEPLOYED), following(move)).move
    step = braking.setpoint.motor_rad - move.setpoint.motor_rad
    np.testing.assert_allclose(step, (rate + braking.setpoint.rate_rad_s) / 2 / 64, atol=1e-12)
    assert (braking.setpoint.rate_rad_s < rate).all()
