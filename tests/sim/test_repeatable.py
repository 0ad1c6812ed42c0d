"""Runs: they begin as told, and the same drive gives the same bits."""

from dataclasses import fields

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoint, MoveJoints, Process
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandCompleted
from fsw.messages import Sensors
from sim.arms import arm_named
from sim.diagnosis_campaign import DiagnosisSession, round_to_counts, run_session
from sim.effects.effect import Effect
from sim.effects.gears import CoulombFriction, ViscousFriction
from sim.effects.geometry import ToolOffset
from sim.effects.sensors import CurrentBias, EncoderZero
from sim.initialisation import start_loop, true_reference
from sim.loop import ClosedLoop, OpenLoopArm, RecordedStart, Setup
from sim.record import CycleRecord
from sim.scenario.effects import BadEffect, effect_text
from sim.sequence import Outcome, run_commands, run_sequence
from sim.setting import World
from tests.sim import lab
from tests.tools import TOOLS

GOAL = tuple(float(a) for a in np.radians([0.4, -60.3, 110.5, 129.0, 91.0]))


def start(
    arm_name: str = "as-built:3", seed: int = 1, with_truth: bool = True, roll_rad: float = 0.1
) -> ClosedLoop:
    """Start the loop of a built arm on a rover that is tilted to a side."""
    arm = arm_named(arm_name)
    world = World(tilt_roll_rad=roll_rad)
    setup = Setup(arm, world, arm.params.poses.ready_rad, seed, lab.true_reference(arm))
    return ClosedLoop(setup, with_truth)


def records(arm_name: str = "as-built:3", seed: int = 1) -> list[CycleRecord]:
    """Run a short move of a built arm, and a second at rest."""
    loop = start(arm_name, seed)
    cycles = list(run_sequence(loop, (MoveJoints(GOAL),)))
    return cycles + [loop.cycle() for _ in range(64)]


@pytest.fixture(scope="module")
def first() -> list[CycleRecord]:
    return records()


def test_the_run_is_worth_comparing_and_its_time_is_the_tick_over_the_cycle_rate(first):
    assert len(first) > 150
    assert any(c.outputs.tool is not None for c in first)
    assert sum(len(c.outputs.evrs) for c in first) >= 4
    assert np.ptp([c.truth.output_rad for c in first], axis=0).max() > 0.01
    assert [c.tick for c in first] == list(range(len(first)))
    assert [c.truth.time_s for c in first] == [k / 64 for k in range(len(first))]


@pytest.mark.slow
def test_another_seed_gives_other_noise_on_the_same_arm_and_another_arm_moves_otherwise(first):
    one, other, arm = (run[0] for run in (first, records(seed=2), records("as-built:4")))
    for field in ("resolver_rad", "current_A", "gravity_R_m_s2"):
        assert not np.array_equal(getattr(other.sensors, field), getattr(one.sensors, field))
    np.testing.assert_array_equal(other.truth.p_RoTo_R_m, one.truth.p_RoTo_R_m)
    np.testing.assert_array_equal(other.sensors.encoder_count, one.sensors.encoder_count)
    assert np.abs(arm.truth.p_RoTo_R_m - one.truth.p_RoTo_R_m).max() > 1e-4


def test_a_software_error_ends_with_the_brakes_holding_and_nothing_after_it(monkeypatch):
    """After an exception the power is off at once, and the plant goes on until the brakes hold."""
    loop = start("nominal")
    loop.cycle((MoveJoints((0.1,) * 5, relative=True),))
    for _ in range(64):
        loop.cycle()
    assert not loop.plant.data.eq_active[loop.plant.at.brake].any()

    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("sim.loop.step", broken)
    record = loop.cycle()
    assert [evr.name for evr in record.outputs.evrs] == ["SoftwareError"]
    assert not record.outputs.joint.busy
    assert loop.plant.data.eq_active[loop.plant.at.brake].all()
    with pytest.raises(RuntimeError, match="ended"):
        loop.cycle()


@pytest.mark.slow
def test_a_run_that_vibrates_has_the_same_bits_whether_its_truth_is_read_or_not():
    ends = []
    for with_truth in (False, True):
        loop = start("nominal", with_truth=with_truth, roll_rad=0.0)
        shake = run_sequence(loop, (Process("portion", (-0.02, 0.0, -1.0), 1.0),))
        assert sum(record.outputs.drive.vibrate for record in shake) > 0
        ends.append(loop.plant.data.qpos.tobytes())
    assert ends[0] == ends[1]


ARM = arm_named("nominal")
REFERENCE = true_reference(ARM)
JOINTS = ARM.params.joints.in_order()
SEED = 3
NOISE_A = 0.02


@pytest.fixture(scope="module")
def run():
    """Record a move of the wrist by two degrees and back."""
    ready = np.array(ARM.params.poses.ready_rad)
    rad_per_count = np.array([2 * np.pi / (j.encoder_counts_per_turn * j.gear_ratio) for j in JOINTS])
    start = round_to_counts(ready, REFERENCE.zero_rad, rad_per_count)
    moves = tuple(MoveJoint(Joint.WRIST, float(ready[Joint.WRIST] + by), "off") for by in (0.03, 0.0))
    session = DiagnosisSession("wrist", "wrist", World(), 20.0, tuple(start), moves, tracked=False)
    loop = ClosedLoop(Setup(ARM, World(), tuple(start), SEED, REFERENCE))
    records = [moment.record for moment in run_session(loop, session)]
    counts = records[0].sensors.encoder_count
    hardstops = np.array([joint.hardstop_rad for joint in JOINTS])
    motor = counts * rad_per_count + REFERENCE.zero_rad
    return RecordedStart(World(), motor, REFERENCE.zero_rad, hardstops), records


def drive_open_loop(run, *effects: Effect, seed: int | None = None) -> list[Sensors]:
    start, records = run
    return list(OpenLoopArm(start, effects, seed).readings(record.outputs.drive for record in records))


@pytest.fixture(scope="module")
def apart(run):
    """Compare the currents of the open loop with an effect and without one."""
    nominal = drive_open_loop(run)
    return lambda effect: difference("current_A", drive_open_loop(run, effect), nominal)


def difference(name: str, one: list[Sensors], other: list[Sensors]) -> np.ndarray:
    return np.array([getattr(a, name) - getattr(b, name) for a, b in zip(one, other, strict=True)])


def test_the_same_plant_under_the_same_drive_reads_the_same_bit_for_bit(run):
    for now, record in zip(drive_open_loop(run, seed=SEED), run[1], strict=True):
        for field in fields(Sensors):
            np.testing.assert_array_equal(getattr(now, field.name), getattr(record.sensors, field.name))


@pytest.mark.slow
def test_without_noise_it_reads_the_mean_of_what_it_reads_with_noise(run):
    off_A = difference("current_A", [r.sensors for r in run[1]], drive_open_loop(run))
    assert np.abs(off_A.mean(axis=0)).max() < 4 * NOISE_A / np.sqrt(len(off_A))
    assert off_A.std() == pytest.approx(NOISE_A, rel=0.05)


def test_a_difference_shows_in_its_own_joint_and_while_that_moves(run, apart):
    off_A = apart(CoulombFriction(Joint.WRIST, 10.0))
    rate = np.array([record.outputs.drive.setpoint_rate_rad_s[Joint.WRIST] for record in run[1]])
    cruising = np.abs(rate) > 0.9 * np.abs(rate).max()
    expected = 10.0 / JOINTS[Joint.WRIST].torque_constant_Nm_A * np.sign(rate[cruising])
    np.testing.assert_allclose(off_A[cruising, Joint.WRIST], expected, rtol=0.05)
    assert not np.delete(off_A, Joint.WRIST, axis=1).any()
    powered = np.array([record.outputs.drive.power_on[Joint.WRIST] for record in run[1]])
    assert not off_A[:-1][~powered[:-1] & ~np.roll(powered, 1)[:-1], Joint.WRIST].any()


def test_what_is_wrong_at_a_joint_on_its_brake_is_not_seen_but_in_its_sensor(apart):
    assert np.abs(apart(ViscousFriction(Joint.ELBOW, 300.0))).max() < 0.01 * NOISE_A
    off_A = apart(CurrentBias(Joint.ELBOW, 0.05))
    np.testing.assert_allclose(off_A, 0.05 * (np.arange(5) == Joint.ELBOW) * np.ones_like(off_A), atol=1e-15)


def test_an_encoder_that_lost_count_shows_in_no_motion(run):
    nominal, lost = (drive_open_loop(run, *e) for e in ((), (EncoderZero(Joint.WRIST, 2e-3),)))
    np.testing.assert_array_equal(lost[0].encoder_count, nominal[0].encoder_count)
    # gravity pulls a little otherwise
    assert np.abs(difference("current_A", lost, nominal)).max() < 0.1 * NOISE_A


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
