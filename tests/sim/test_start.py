"""Runs that a Python program starts and commands."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandCompleted
from sim.arms import UnknownArm, arm_named
from sim.effects.gears import CoulombFriction
from sim.effects.geometry import ToolOffset
from sim.initialisation import start_loop
from sim.scenario.effects import BadEffect, effect_text
from sim.sequence import Outcome, run_commands
from tests.tools import TOOLS

READY_RAD = arm_named("nominal").params.poses.ready_rad
TURN = MoveJoint(Joint.WRIST, READY_RAD[Joint.WRIST] + 0.02)


def test_a_run_begins_stowed_and_calibrated_and_an_effect_is_the_same_as_its_text():
    loop = start_loop(effects=["joint-seized:elbow:at_s=7"])
    assert loop.state.mode is Mode.STOWED
    assert loop.state.joints.reference.calibrated.all()
    # an effect that begins in the run is not one of the arm
    assert (loop.setup.arm.effects, len(loop.setup.effects)) == ((), 1)
    by_text, by_class = (
        start_loop("as-built:7", effects=[effect], start_rad=READY_RAD)
        for effect in ("coulomb-friction:elbow:torque_Nm=25", CoulombFriction(Joint.ELBOW, 25.0))
    )
    assert by_text.setup.arm == by_class.setup.arm
    assert by_text.setup.arm.effects[-1] == CoulombFriction(Joint.ELBOW, 25.0)


def test_a_wrong_name_of_an_arm_or_an_effect_is_refused():
    with pytest.raises(UnknownArm):
        start_loop("as-bilt:7")
    with pytest.raises(BadEffect):
        start_loop(effects=["coulomb-friction:elbow"])


def test_a_sequence_keeps_every_cycle_and_a_series_has_the_values_of_the_cycles_that_have_them():
    result = run_commands(start_loop(start_rad=READY_RAD), TURN)
    assert result.outcome is Outcome.DONE
    assert [one.tick for one in result.cycles] == list(range(len(result.cycles)))
    assert CommandCompleted("MoveJoint") in [evr for _, evr in result.evrs]
    time_s, motor_rad = result.series("outputs.joint.motor_rad")
    assert motor_rad.shape == (len(result.cycles), 5)
    np.testing.assert_allclose(np.diff(time_s), 1 / 64)
    tool_s, p_RoTo_R_m = result.series("outputs.tool.p_RoTo_R_m")
    assert 0 < len(tool_s) < len(time_s)
    assert p_RoTo_R_m.shape == (len(tool_s), 3)
    with pytest.raises(AttributeError, match="speed"):
        result.series("outputs.joint.speed")


def test_a_monitor_stops_the_arm_and_the_remaining_commands():
    loop = start_loop(start_rad=READY_RAD)
    result = run_commands(loop, TURN, TURN, stop_when=lambda record: record.tick >= 64)
    assert result.outcome is Outcome.STOPPED
    assert CommandCompleted("MoveJoint") not in [evr for _, evr in result.evrs]
    assert not result.cycles[-1].outputs.joint.busy
    assert [one.tick for one in result.cycles if one.commands] == [0, 65]


def test_the_text_of_an_effect_names_a_tool_of_the_arm_that_is_started():
    arm = arm_named("m2020")
    effect = ToolOffset(next(tool for tool in arm.params.tool_names if tool not in TOOLS), "x", 0.01)
    start_loop(arm, effects=[effect_text(effect)])
    with pytest.raises(BadEffect, match="is not known"):
        start_loop("nominal", effects=[effect_text(effect)])
