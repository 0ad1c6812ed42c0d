"""Faults during a run: their effect on the plant, and the response of flight software."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandCompleted, CyclesSkipped, FaultResponse, ReadingNotUsed
from fsw.dictionary.faults import (
    CyclesMissed,
    Fault,
    MotorStalled,
    OverCurrent,
    OverTemperature,
    ReadingImplausible,
    SensorFrozen,
    TiltChanged,
)
from fsw.dictionary.types import joints5
from fsw.messages import ActuatorCommand, Sensors
from fsw.protect.responses import RESPONSE_TO, Response
from helpers.marks import slow_but
from sim.arms import arm_named
from sim.avionics import VIBRATION_N, Avionics
from sim.effects import faults
from sim.effects.effect import Effect, Hardware, nominal_hardware
from sim.effects.environment import PowerLoss
from sim.effects.gears import ColdFriction
from sim.effects.joints import BusSag, CommandDelay
from sim.frames import FLIP, gravity_in_rover
from sim.loop import ClosedLoop, Setup
from sim.setting import World
from tests.fsw.rig import content
from tests.sim import lab
from tests.sim.effects.test_cycle_rate import EFFECTS, JOINT
from tests.tools import SWITCHES, switch_index
from validation.commands import cycle_with
from validation.wild_readings import Draw

NOW_S = 0.0
READINGS = {"encoder_count": 5, "resolver_rad": 5, "current_A": 5, "winding_C": 5, "gravity_R_m_s2": 3}
ALL, NONE = np.ones(5, bool), np.zeros(5, bool)


def avionics_with(*troubles, plant=None) -> Avionics:
    hardware: Hardware = replace(
        nominal_hardware(), resolver_noise_rad=0.0, current_noise_A=0.0, gravity_noise_m_s2=0.0
    )
    for fault in troubles:
        hardware = fault.on_hardware(hardware)
    if plant is None:
        plant = lab.plant()
        plant.place(lab.READY_RAD, 0.5)
    return Avionics(plant, hardware, np.random.default_rng(3))


def read(sensors: Sensors, name: str) -> np.ndarray:
    return np.asarray(getattr(sensors, name), float)


@pytest.fixture(scope="module")
def quiet() -> Sensors:
    return avionics_with().sense()


@pytest.mark.parametrize("index", [None, 1])
@pytest.mark.parametrize("name", READINGS)
def test_a_biased_sensor_reads_too_much_by_its_bias_and_no_other_does(quiet, name, index):
    biased = avionics_with(faults.SensorFault(NOW_S, name, "biased", index, 40.0)).sense()
    for other in READINGS:
        there = (index is None) | (np.arange(READINGS[other]) == index)
        np.testing.assert_allclose(
            read(biased, other) - read(quiet, other), 40.0 * there * (other == name), atol=1e-9
        )


@pytest.mark.parametrize("name", [name for name in READINGS if name != "encoder_count"])
def test_a_sensor_that_reads_no_number_does_so_where_it_is_told(quiet, name):
    readings = avionics_with(faults.SensorFault(NOW_S, name, "nan", 2)).sense()
    np.testing.assert_array_equal(np.isnan(read(readings, name)), np.arange(READINGS[name]) == 2)


@pytest.mark.parametrize("name", READINGS)
def test_a_noisy_sensor_scatters_by_its_size(quiet, name):
    sensors = avionics_with(faults.SensorFault(NOW_S, name, "noisy", 0, 30.0))
    scatter = np.array([read(sensors.sense(), name) for _ in range(400)]) - read(quiet, name)
    assert scatter[:, 0].std() == pytest.approx(30.0, rel=0.15)
    assert not scatter[:, 1:].any()


def test_a_frozen_sensor_keeps_what_it_read_when_its_time_came():
    plant = lab.plant()
    plant.place(lab.READY_RAD, 0.5)
    sensors = avionics_with(faults.SensorFault(0.5, "resolver_rad", "frozen", Joint.ELBOW), plant=plant)
    resolver_rad = []
    for cycle in range(64):
        plant.data.qpos[plant.at.gear] = 1e-3 * cycle
        plant.data.time = cycle / CYCLE_HZ
        resolver_rad.append(sensors.sense().resolver_rad)
    change = np.diff(resolver_rad, axis=0)
    assert change[:32].all()
    assert not change[32:, Joint.ELBOW].any()
    assert np.delete(change[32:], Joint.ELBOW, axis=1).all()


@pytest.mark.parametrize(("size", "closed"), [(1.0, True), (-1.0, False)])
def test_a_switch_biased_by_one_is_stuck_whatever_touches(size, closed):
    sensors = avionics_with(faults.SensorFault(NOW_S, "switch_closed", "biased", switch_index("drt_1"), size))
    plant = sensors._plant
    for force_N in (0.0, 50.0):
        plant.data.sensordata[:] = force_N
        expected = np.where(np.isin(SWITCHES, ["drt_1"]), closed, force_N > 2.0)
        np.testing.assert_array_equal(sensors.sense().switch_closed, expected)


def begin_move(troubles: tuple[faults.Timed, ...] = (), effects: tuple[Effect, ...] = ()) -> ClosedLoop:
    """Return a run at the start of a move of all joints."""
    arm = arm_named("nominal").with_effects(effects)
    setup = Setup(arm, World(), joints5(lab.READY_RAD), seed=4, reference=lab.true_reference(arm))
    loop = ClosedLoop(setup, with_truth=True).fork(troubles)
    loop.cycle((MoveJoints(joints5(lab.READY_RAD + 0.1)),))
    return loop


@cache
def moving() -> ClosedLoop:
    """Return a run in the middle of a move of all joints; tests fork it and never run it."""
    loop = begin_move()
    for _ in range(3 * CYCLE_HZ):
        assert loop.cycle().outputs.joint.busy
    return loop


@cache
def at_rest() -> ClosedLoop:
    """Return a run on its brakes; tests fork it and never run it."""
    arm = arm_named("nominal")
    loop = ClosedLoop(Setup(arm, World(), joints5(lab.READY_RAD), reference=lab.true_reference(arm)))
    for _ in range(40):
        loop.cycle()
    return loop


def now_s() -> float:
    return float(moving().plant.data.time)


EACH_CYCLE = (*EFFECTS, CommandDelay(JOINT, 0.04), BusSag(1.0), ColdFriction(JOINT, 1.5))
"""Effects that look at the arm in each cycle and keep what they saw."""


def test_a_run_and_its_forks_go_on_bit_by_bit_alike_even_if_one_was_troubled():
    first = begin_move(effects=EACH_CYCLE)
    for _ in range(2 * CYCLE_HZ):
        first.cycle()
    assert abs(first.state.joints.motor_rate_rad_s).min() > 1e-3
    snapshot = first.fork()
    now = float(first.plant.data.time)
    troubled = first.fork((faults.JointSeized(now, Joint.ELBOW), faults.TiltStep(now, 0.3, 0.0)))
    for _ in range(100):
        troubled.cycle()
    ahead = [content(first.cycle()) for _ in range(200)]
    again = snapshot.fork()
    assert [content(snapshot.cycle()) for _ in range(200)] == ahead
    assert [content(again.cycle()) for _ in range(200)] == ahead


def test_nothing_happens_before_its_time():
    calm, waiting = moving().fork(), moving().fork((faults.WeakMotor(now_s() + 1.0, Joint.ELBOW, 0.1),))
    same = [content(calm.cycle()) == content(waiting.cycle()) for _ in range(100)]
    assert all(same[:64])
    assert not any(same[70:])


EXPECTED = {
    "resolver frozen": (faults.SensorFault(NOW_S, "resolver_rad", "frozen", 2), SensorFrozen),
    "resolver biased": (faults.SensorFault(NOW_S, "resolver_rad", "biased", 2, 0.02), ReadingImplausible),
    "resolver no number": (faults.SensorFault(NOW_S, "resolver_rad", "nan", 2), ReadingImplausible),
    "encoder frozen": (faults.SensorFault(NOW_S, "encoder_count", "frozen", 2), MotorStalled),
    "encoder biased": (faults.SensorFault(NOW_S, "encoder_count", "biased", 2, 2000.0), ReadingImplausible),
    "current frozen": (faults.SensorFault(NOW_S, "current_A", "frozen", 0), SensorFrozen),
    "current no number": (faults.SensorFault(NOW_S, "current_A", "nan", 0), ReadingImplausible),
    "winding no number": (faults.SensorFault(NOW_S, "winding_C", "nan", 0), ReadingImplausible),
    "winding reads hot": (faults.SensorFault(NOW_S, "winding_C", "biased", 4, 100.0), ReadingImplausible),
    "winding reads cold": (faults.SensorFault(NOW_S, "winding_C", "biased", 4, -100.0), ReadingImplausible),
    "gravity frozen": (faults.SensorFault(NOW_S, "gravity_R_m_s2", "frozen"), SensorFrozen),
    "gravity biased": (faults.SensorFault(NOW_S, "gravity_R_m_s2", "biased", 0, 0.5), TiltChanged),
    "gravity no number": (faults.SensorFault(NOW_S, "gravity_R_m_s2", "nan", 1), ReadingImplausible),
    "seized": (faults.JointSeized(NOW_S, Joint.ELBOW), MotorStalled),
    "a tenth of the torque": (faults.WeakMotor(NOW_S, Joint.WRIST, 0.1), OverCurrent),
    "hot": (faults.HotMotor(NOW_S, Joint.WRIST, 130.0), OverTemperature),
    "tilted": (faults.TiltStep(NOW_S, 0.05, 0.0), TiltChanged),
    "cycles missed": (faults.MissedCycles(NOW_S, 20), CyclesMissed),
}


@pytest.mark.parametrize("name", slow_but(EXPECTED, *list(EXPECTED)[::2]))
def test_a_fault_in_the_middle_of_a_move_ends_on_the_brakes_by_the_response_of_the_table(name):
    fault, kind = EXPECTED[name]
    loop = moving().fork((replace(fault, at_s=now_s() + 0.25),))
    evrs = lab.run_to_rest(loop)
    found = [evr for evr in evrs if isinstance(evr, Fault)]
    assert isinstance(found[0], kind)
    assert FaultResponse(RESPONSE_TO[kind]) in evrs
    assert lab.is_at_rest(loop)
    refuses = RESPONSE_TO[kind] is not Response.STOP_AND_BRAKE
    assert (loop.state.fault is not None) is refuses


TOLERATED = {
    "winding frozen": faults.SensorFault(NOW_S, "winding_C", "frozen"),
    "a little gravity": faults.SensorFault(NOW_S, "gravity_R_m_s2", "biased", 0, 0.02),
    "noisy current": faults.SensorFault(NOW_S, "current_A", "noisy", None, 1.0),
    "noisy resolver": faults.SensorFault(NOW_S, "resolver_rad", "noisy", None, 2e-3),
    "resolver a little off": faults.SensorFault(NOW_S, "resolver_rad", "biased", 1, 2e-3),
    "half the torque": faults.WeakMotor(NOW_S, Joint.ELEVATION, 0.5),
    "three cycles missed": faults.MissedCycles(NOW_S, 3),
    "a switch stuck open": faults.SensorFault(NOW_S, "switch_closed", "biased", 3, -1.0),
    "a brake that would not release": faults.BrakeStuck(NOW_S, Joint.ELBOW),
}


@pytest.mark.parametrize("name", slow_but(TOLERATED, *list(TOLERATED)[::2]))
def test_what_is_tolerated_does_not_end_a_move(name):
    loop = moving().fork((replace(TOLERATED[name], at_s=now_s() + 0.25),))
    evrs = lab.run_to_rest(loop)
    assert CommandCompleted("MoveJoints") in evrs
    assert not [evr for evr in evrs if isinstance(evr, Fault)]
    assert lab.is_at_rest(loop)


@pytest.mark.parametrize("fault", [faults.JointSeized, faults.BrakeStuck])
@pytest.mark.parametrize("joint", slow_but([Joint.AZIMUTH, Joint.TURRET], Joint.AZIMUTH))
def test_a_joint_that_does_not_come_off_its_brake_stalls_at_the_start_of_the_next_move(fault, joint):
    arm = arm_named("nominal")
    loop = ClosedLoop(Setup(arm, World(), joints5(lab.READY_RAD), reference=lab.true_reference(arm)))
    loop = loop.fork((fault(NOW_S, joint),))
    at = loop.plant.motor_rad()[joint]
    loop.cycle((MoveJoints(joints5(lab.READY_RAD + 0.05 * (np.arange(5) == joint))),))
    evrs = lab.run_to_rest(loop)
    (evr,) = [evr for evr in evrs if isinstance(evr, Fault)]
    assert isinstance(evr, MotorStalled)
    assert evr.joint is joint
    assert loop.plant.motor_rad()[joint] == pytest.approx(at, abs=1e-4)
    assert lab.is_at_rest(loop)


def test_a_seized_joint_stands_and_the_others_go_on_until_flight_software_notices():
    loop = moving().fork((faults.JointSeized(now_s(), Joint.ELBOW),))
    loop.cycle()
    before = loop.plant.motor_rad().copy()
    for _ in range(8):
        loop.cycle()
    went = np.abs(loop.plant.motor_rad() - before)
    assert went[Joint.ELBOW] < 1e-4
    assert np.delete(went, Joint.ELBOW).min() > 1e-3


def test_a_weak_motor_draws_twice_the_current_for_the_same_torque():
    """A motor that weakens in a move is taken for one that an obstacle resists; this one is weak before."""
    drawn = []
    for troubles in ((), (faults.WeakMotor(NOW_S, Joint.WRIST),)):
        loop = begin_move(troubles)
        currents = [loop.cycle().sensors.current_A for _ in range(4 * CYCLE_HZ)]
        drawn.append(np.mean(currents[3 * CYCLE_HZ :], axis=0))
    times = drawn[1] / drawn[0]
    assert times[Joint.WRIST] == pytest.approx(2.0, rel=0.1)
    np.testing.assert_allclose(np.delete(times, Joint.WRIST), 1.0, rtol=0.1)


def test_flight_software_is_not_called_in_missed_cycles_and_the_last_drive_holds():
    loop, count = moving().fork((faults.MissedCycles(now_s(), 3),)), 3
    before = loop.cycle()
    after = loop.cycle()
    assert after.tick == before.tick + 1
    assert after.sensors.cycle == before.sensors.cycle + 1 + count
    assert after.truth.time_s - before.truth.time_s == pytest.approx((1 + count) / CYCLE_HZ)
    assert CyclesSkipped(count) in after.outputs.evrs
    assert loop.cycle().sensors.cycle == after.sensors.cycle + 1


def test_a_tilt_step_turns_gravity_and_keeps_its_size():
    loop = moving().fork((faults.TiltStep(now_s(), 0.1, -0.2),))
    loop.cycle()
    gravity = FLIP * loop.plant.model.opt.gravity
    np.testing.assert_allclose(gravity, gravity_in_rover(0.1, -0.2, 3.711), atol=1e-12)
    reads = np.mean([loop.cycle().sensors.gravity_R_m_s2 for _ in range(100)], axis=0)
    np.testing.assert_allclose(reads, gravity, atol=5 * 0.005 / 10)


def test_a_hot_motor_is_that_hot():
    loop = moving().fork((faults.HotMotor(now_s(), Joint.WRIST, 60.0),))
    for _ in range(2 * CYCLE_HZ):
        read_C = loop.cycle().sensors.winding_C
    assert read_C[Joint.WRIST] == pytest.approx(60.0, abs=1.0)
    assert np.delete(read_C, Joint.WRIST).max() < 25.0


WRONG_ENCODER = Draw("encoder_count", Joint.ELBOW, "add", 1000.0, (0,))


@pytest.mark.parametrize("make", [at_rest, moving], ids=["at rest", "in a move"])
def test_one_wrong_encoder_reading_changes_nothing_but_what_is_told(make):
    calm, wrong = make().fork(), make().fork()
    evrs = list(cycle_with(wrong, (), WRONG_ENCODER).outputs.evrs)
    calm.cycle()
    for cycle in range(128):
        with_it, without = wrong.cycle(), calm.cycle()
        assert content(with_it.outputs.drive) == content(without.outputs.drive)
        evrs += with_it.outputs.evrs
        if cycle >= 2:
            off_rad = wrong.state.joints.output_rad - calm.state.joints.output_rad
            assert np.abs(off_rad).max() < 5e-5
    (evr,) = evrs
    assert isinstance(evr, ReadingNotUsed)
    assert evr.sensor == "encoder_count[2]"


def test_the_vibration_motor_pulls_all_around_in_the_plane_of_the_turret_and_stops():
    plant = lab.plant()
    plant.place(lab.READY_RAD, 0.5)
    sensors, body = avionics_with(plant=plant), plant.model.body("turret").id
    off = ActuatorCommand(sensors.encoder_count(), np.zeros(5), np.full(5, 3.0), NONE, NONE, vibrate=False)
    pulls = []
    for _ in range(8):
        sensors.sense()
        sensors.apply(replace(off, vibrate=True))
        R_WB = plant.data.xmat[body].reshape(3, 3)
        force, moment = np.split(plant.data.xfrc_applied[body], 2)
        pulls.append(R_WB.T @ force)
        assert not moment.any()
        plant.step()
    pulls = np.array(pulls)
    np.testing.assert_allclose(np.linalg.norm(pulls, axis=1), VIBRATION_N)
    np.testing.assert_allclose(pulls[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(pulls[:4].sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(pulls[4:], pulls[:4], atol=1e-9)
    np.testing.assert_allclose(np.cross(pulls[:-1], pulls[1:])[:, 2], VIBRATION_N**2)
    sensors.apply(off)
    assert not plant.data.xfrc_applied.any()


def test_without_power_nothing_vibrates():
    plant = lab.plant()
    plant.place(lab.READY_RAD, 0.5)
    sensors = avionics_with(PowerLoss(plant.data.time + 0.5 / CYCLE_HZ), plant=plant)
    shaking = ActuatorCommand(sensors.encoder_count(), np.zeros(5), np.full(5, 3.0), NONE, NONE, vibrate=True)
    sensors.apply(shaking)
    assert plant.data.xfrc_applied.any()
    plant.step()
    sensors.apply(shaking)
    assert not plant.data.xfrc_applied.any()
