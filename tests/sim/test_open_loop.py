"""Open-loop arm: it repeats the readings of the closed loop, and differences stay in their joint."""

from dataclasses import fields

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import Joint
from fsw.messages import Sensors
from sim.arms import arm_named
from sim.diagnosis_campaign import DiagnosisSession, round_to_counts, run_session
from sim.effects.effect import Effect
from sim.effects.gears import CoulombFriction, ViscousFriction
from sim.effects.sensors import CurrentBias, EncoderZero
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, OpenLoopArm, RecordedStart, Setup, SimulationOptions
from sim.setting import World

ARM = arm_named("nominal")
REFERENCE = true_reference(ARM)
JOINTS = ARM.params.joints.in_order()
SEED = 3
NOISE_A = 0.02
BRIEF = SimulationOptions(settle_s=2.0)


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


def drive_open_loop(run, options: SimulationOptions, *effects: Effect) -> list[Sensors]:
    start, records = run
    return list(OpenLoopArm(start, effects, options).readings(record.outputs.drive for record in records))


@pytest.fixture(scope="module")
def apart(run):
    """Compare the currents of the open loop with an effect and without one."""
    nominal = drive_open_loop(run, BRIEF)
    return lambda effect: difference("current_A", drive_open_loop(run, BRIEF, effect), nominal)


def difference(name: str, one: list[Sensors], other: list[Sensors]) -> np.ndarray:
    return np.array([getattr(a, name) - getattr(b, name) for a, b in zip(one, other, strict=True)])


def test_the_same_plant_under_the_same_drive_reads_the_same_bit_for_bit(run):
    for now, record in zip(drive_open_loop(run, SimulationOptions(SEED)), run[1], strict=True):
        for field in fields(Sensors):
            np.testing.assert_array_equal(getattr(now, field.name), getattr(record.sensors, field.name))


def test_without_noise_it_reads_the_mean_of_what_it_reads_with_noise(run):
    off_A = difference("current_A", [r.sensors for r in run[1]], drive_open_loop(run, SimulationOptions()))
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
    nominal, lost = (drive_open_loop(run, BRIEF, *e) for e in ((), (EncoderZero(Joint.WRIST, 2e-3),)))
    np.testing.assert_array_equal(lost[0].encoder_count, nominal[0].encoder_count)
    # gravity pulls a little otherwise
    assert np.abs(difference("current_A", lost, nominal)).max() < 0.1 * NOISE_A
