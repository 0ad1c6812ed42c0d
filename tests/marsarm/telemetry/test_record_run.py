"""Logs of runs that a Python program carries out."""

import json

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import Joint
from marsarm.replay.replay import ReplayRequest, replay
from marsarm.telemetry.read import read_log
from marsarm.telemetry.record_run import record_commands
from sim.arms import BuiltArm, arm_named
from sim.initialisation import start_loop

PARAMS = arm_named("nominal").params
READY_RAD = PARAMS.poses.ready_rad
TURN = MoveJoint(Joint.WRIST, READY_RAD[Joint.WRIST] + 0.02)


def test_the_log_holds_every_cycle_and_replays_bit_for_bit(tmp_path):
    loop = start_loop("as-built:7", effects=["coulomb-friction:elbow:torque_Nm=25"], start_rad=READY_RAD)
    result = record_commands(tmp_path / "run.mcap", loop, TURN)
    log = read_log(tmp_path / "run.mcap")
    motor_rad = result.series("outputs.joint.motor_rad")[1]
    np.testing.assert_array_equal(log["/joint"]["motor_rad"], motor_rad)
    assert log.header["arm"] == "as-built:7"
    assert json.loads(log.header["effects"]) == ["coulomb-friction:elbow:torque_Nm=25.0"]
    assert replay(ReplayRequest(tmp_path / "run.mcap")).differences.identical


def test_an_arm_of_the_program_itself_is_recorded_with_all_its_effects(tmp_path):
    arm = BuiltArm("mine", arm_named("as-built:7").effects[:2], PARAMS)
    record_commands(tmp_path / "run.mcap", start_loop(arm, start_rad=READY_RAD), TURN)
    assert len(json.loads(read_log(tmp_path / "run.mcap").header["effects"])) == 2


def test_a_run_that_has_begun_is_not_recorded(tmp_path):
    loop = start_loop(start_rad=READY_RAD)
    loop.cycle()
    with pytest.raises(ValueError, match="tick 1"):
        record_commands(tmp_path / "run.mcap", loop, TURN)
    assert not (tmp_path / "run.mcap").exists()
