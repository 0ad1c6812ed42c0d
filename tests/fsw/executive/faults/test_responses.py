"""What is done about each fault, by the table, in the documents, and in time; what motors should not do."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import ticks
from fsw.dictionary import faults
from fsw.dictionary.commands import ClearFault, MoveJoints, Stop
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted
from fsw.motion.move import Phase
from fsw.protect.responses import RESPONSE_TO, Response
from fsw.state import Sequence
from helpers.marks import slow_but
from tests.fsw.executive.faults import lab
from tests.fsw.protect.lab import persistence_of
from tests.fsw.rig import Rig, alive, floats

RESPONDED = {
    Response.BRAKE_AND_REFUSE: lab.REFUSED,
    Response.POWER_OFF: lab.UNPOWERED,
    Response.STOP_AND_BRAKE: lab.STOPPED,
}
MISSED = lab.BOUNDS.missed_cycles + 1
LATEST = 3
"""Cycles from a persistence to the drive that answers it."""


def tamper(rig):
    """Replace the path by one that asks for a jump."""
    rig.state = lab.misplanned(rig, rig.state.move.setpoint.motor_rad + 0.1)
    return {}


def missing(rig):
    """Cycles are missed, once."""
    rig.cycles += 0 if hasattr(rig, "missed") else MISSED
    rig.missed = True
    return {}


def seized(rig):
    """All joints stand."""
    rig.stood = getattr(rig, "stood", rig.count)
    return {"encoder_count": rig.stood}


def tilted(rig, more_m_s2=0.0):
    """Gravity that has turned by nearly the bound, and by more."""
    turned_m_s2 = 0.97 * 3.711 * np.tan(lab.BOUNDS.tilt_rad)
    return np.array([turned_m_s2 + more_m_s2, 0.0, 3.711]) + alive(rig.cycles)


LAG_RAD = lab.BOUNDS.following_error_rad
BEYOND = {
    faults.ReadingImplausible: lambda rig: {"current_A": np.full(5, np.nan)},
    faults.SensorFrozen: lambda rig: {"current_A": np.zeros(5)},
    faults.CyclesMissed: missing,
    faults.CycleCountWrong: lambda rig: {"cycle": rig.cycles - 51},
    faults.TiltChanged: lambda rig: {"gravity_R_m_s2": tilted(rig, 0.4)},
    faults.SetpointUnsafe: tamper,
    faults.SoftLimitPassed: lambda rig: lab.with_limit_at(rig, Joint.ELBOW, 0.0),
    faults.MotorStalled: seized,
    faults.FollowingErrorHigh: lambda rig: lab.off_set_point(rig, Joint.ELBOW, -LAG_RAD - 2e-4),
    faults.OverCurrent: lambda rig: lab.currents(Joint.WRIST, 2.95 + alive(rig.cycles)),
    faults.OverTemperature: lambda rig: lab.heat(rig, Joint.WRIST, 150.0),
    faults.UnderTemperature: lambda rig: lab.heat(rig, Joint.WRIST, -100.0),
    faults.ResolverDisagrees: lambda rig: lab.resolver_off(rig, Joint.ELBOW, 0.009),
    faults.ContactInFreeSpace: lambda rig: lab.closed("drt_1"),
}
"""Readings of a moving arm that pass the bound with the first of them."""
UP_TO = {
    faults.TiltChanged: lambda rig: {"gravity_R_m_s2": tilted(rig)},
    faults.FollowingErrorHigh: lambda rig: lab.off_set_point(rig, Joint.ELBOW, -LAG_RAD + 4e-4),
    faults.OverTemperature: lambda rig: lab.heat(rig, Joint.WRIST, lab.BOUNDS.winding_max_C),
    faults.UnderTemperature: lambda rig: lab.heat(rig, Joint.WRIST, lab.BOUNDS.winding_min_C),
    faults.ResolverDisagrees: lambda rig: lab.resolver_off(rig, Joint.ELBOW, 0.0049),
}
"""Readings up to the bound, of sensors that cannot jump there."""
APPROACH_CYCLES = 300
STANDING_CYCLES = 3
"""Cycles in which a motor that stands falls back nearly as far as friction explains."""
BY_A_CALL = {faults.ContactLost, faults.PreloadOutside, faults.UnexpectedContact}
"""Tested in tests/fsw/protect and in test_touch.py."""
BY_THE_MOVE = {
    *(faults.NoContact, faults.NotSettled, faults.StalledEarly, faults.MotorStuck, faults.CurrentImplausible),
    *(faults.HardstopMissed, faults.HardstopMoved, faults.HardstopUnclear, faults.HardstopImplausible),
}
"""Found by a move about itself; tested with the moves."""


def test_every_monitor_is_timed_here_but_those_of_moves_about_themselves():
    assert set(BEYOND) | BY_A_CALL | BY_THE_MOVE == set(RESPONSE_TO)


def until_the_drive_differs(rig, twin, trouble):
    """Cycles from the first troubled reading to the first drive that an untroubled arm would not get."""
    for cycle in range(1, 1000):
        readings = trouble(rig)
        here, there = rig.cycle(**readings).drive, twin.cycle().drive
        if any(
            not np.array_equal(getattr(here, name), getattr(there, name))
            for name in ("power_on", "brake_release", "setpoint_rate_rad_s")
        ):
            return cycle
    raise AssertionError("the drive never changed")


@pytest.mark.parametrize("kind", BEYOND, ids=lambda kind: kind.__name__)
def test_from_its_persistence_to_the_drive_it_takes_a_fault_at_most_three_cycles(kind):
    persistence, trouble = persistence_of(kind), BEYOND[kind]
    command = MoveJoints(floats(lab.START + 0.3))
    rig, twin = lab.moving(command), lab.moving(command)
    for _ in range(60):
        rig.cycle()
        twin.cycle()
    for _ in range(STANDING_CYCLES * (kind is faults.MotorStalled)):
        rig.cycle(**seized(rig))
        twin.cycle()
    for _ in range(APPROACH_CYCLES * (kind in UP_TO)):
        rig.cycle(**UP_TO[kind](rig))
        twin.cycle()
    cycles = until_the_drive_differs(rig, twin, trouble)
    assert persistence <= cycles <= persistence + LATEST
    assert isinstance(lab.found(rig, faults.Fault)[0], kind)
    assert RESPONDED[RESPONSE_TO[kind]] in rig.evrs
    assert (rig.state.mode is Mode.FAULTED) is (RESPONSE_TO[kind] is not Response.STOP_AND_BRAKE)


def test_stop_and_brake_ends_as_a_commanded_stop_does():
    ends = []
    for trouble in (lab.skip, lambda rig: rig.cycle(Stop())):
        rig = lab.moving(MoveJoints(floats(lab.START + 0.3)))
        trouble(rig)
        rig.run()
        assert CommandAborted("MoveJoints") in rig.evrs
        assert rig.state.fault is None
        assert not rig.outputs.drive.power_on.any()
        ends.append((rig.state.mode, *rig.count))
    assert ends[0][0] is ends[1][0] is Mode.DEPLOYED
    # missed cycles are confirmed by the next one, and a fault is answered one cycle after a command
    cycle_rad = 2 * lab.CONFIG.speed_rad_s / 64
    apart_rad = np.abs(np.subtract(ends[0][1:], ends[1][1:])) * lab.CONFIG.rad_per_count
    assert (apart_rad <= cycle_rad).all()


@pytest.mark.parametrize("phase", [Phase.RELEASE, Phase.SETTLE])
def test_stop_and_brake_of_a_move_that_is_not_on_its_way_brakes_at_once(phase):
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.begin(MoveJoints(floats(lab.START + 0.002)))
    while rig.state.move.phase is not phase:
        rig.cycle()
    assert not lab.skip(rig).drive.brake_release.any()
    rig.run()
    assert CommandAborted("MoveJoints") in rig.evrs
    assert rig.state.mode is Mode.DEPLOYED


def test_while_the_arm_is_being_stopped_another_stop_is_only_told_and_a_severer_fault_is_answered():
    rig = lab.moving(MoveJoints(floats(lab.START + 0.3)))
    rig.cycle(Stop())
    stopping = rig.state.move
    lab.skip(rig)
    assert rig.state.move.plan.paths == stopping.plan.paths
    most = lab.BOUNDS.missed_cycles
    assert rig.evrs[-2:] == [faults.CyclesMissed(most + 1, most), lab.STOPPED]
    rig.cycle(**lab.closed("drill_1"))
    assert rig.state.mode is Mode.FAULTED
    assert lab.braked(rig)


SEQUENCE = Sequence("CalibrateAll", (MoveJoints(floats(lab.START)), MoveJoints(floats(lab.START + 0.1))))
TROUBLES = {
    Response.STOP_AND_BRAKE: lambda rig: lab.heat(rig, Joint.WRIST, -100.0),
    Response.BRAKE_AND_REFUSE: lambda rig: lab.closed("drt_1"),
    Response.POWER_OFF: lambda rig: lab.heat(rig, Joint.WRIST, 150.0),
}


@pytest.mark.parametrize("clearing", [(), (ClearFault(),)], ids=["at the end", "in every cycle"])
@pytest.mark.parametrize("response", Response)
def test_a_sequence_does_not_go_on_after_any_response(response, clearing):
    rig = lab.moving()
    rig.state = replace(rig.state, sequence=SEQUENCE)
    while RESPONDED[response] not in rig.evrs:
        rig.cycle(**TROUBLES[response](rig))
    while rig.outputs.joint.busy:
        rig.cycle(*clearing)
    for _ in range(20):
        assert not rig.cycle(ClearFault()).drive.power_on.any()
    assert rig.evrs.count(CommandAborted("CalibrateAll")) == 1
    assert rig.evrs.count(CommandAborted("MoveJoints")) == 1
    assert rig.state.sequence is None


def test_brakes_hold_before_power_goes_off_and_let_go_before_anything_moves():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    start = rig.count.copy()
    rig.begin(MoveJoints(floats(lab.START + 0.002)))
    released_for = 0
    while np.array_equal(rig.outputs.drive.setpoint_count, start):
        assert rig.outputs.drive.power_on.all()
        assert rig.outputs.drive.brake_release.all()
        released_for += 1
        rig.cycle()
    assert released_for >= ticks(lab.CONFIG.params.motion.brake_delay_s)
    while rig.outputs.drive.brake_release.any():
        rig.cycle()
    powered_for = 0
    while rig.outputs.drive.power_on.any():
        powered_for += 1
        rig.cycle()
    assert powered_for >= ticks(lab.CONFIG.params.motion.brake_delay_s)


CLEAR_OF_THE_ROVER = [
    *((joint, "max") for joint in Joint if joint is not Joint.AZIMUTH),
    *((joint, "min") for joint in (Joint.ELEVATION, Joint.WRIST, Joint.TURRET)),
]


@pytest.mark.parametrize(("joint", "end"), CLEAR_OF_THE_ROVER)
def test_an_arm_beyond_a_soft_limit_can_be_cleared_and_moved_back(joint, end):
    outward = 1 if end == "max" else -1
    pose = lab.START.copy()
    limit = getattr(lab.CONFIG.arm, f"soft_{end}_rad")[joint]
    pose[joint] = limit + outward * (lab.BOUNDS.soft_limit_margin_rad + 1e-3)
    rig = Rig(lab.CONFIG, start_rad=pose)
    for _ in range(lab.BOUNDS.reading_persistence):
        rig.cycle(current_A=[np.nan] * 5)
    rig.cycle(ClearFault())
    assert rig.state.mode is Mode.DEPLOYED
    back = pose.copy()
    back[joint] = limit - outward * 0.05
    assert CommandCompleted("MoveJoints") in rig.run(MoveJoints(floats(back)))


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("wrong", ["nan", "jump"])
def test_a_wrong_path_ends_at_the_brakes_in_the_same_cycle_and_never_reaches_the_motors(joint, wrong):
    rig = lab.moving()
    before = rig.outputs.drive.setpoint_count
    last = rig.state.move.setpoint.motor_rad
    wanted = np.nan if wrong == "nan" else last[joint] + 0.1
    rig.state = lab.misplanned(rig, np.where(np.arange(5) == joint, wanted, last))
    drive = rig.cycle().drive
    assert isinstance(rig.evrs[0], faults.SetpointUnsafe)
    assert rig.evrs[0].joint is joint
    assert rig.evrs[1] == lab.REFUSED
    assert rig.state.mode is Mode.FAULTED
    assert not drive.brake_release.any()
    assert not drive.setpoint_rate_rad_s.any()
    assert np.abs(drive.setpoint_count - before).max() <= 2
    rig.run()
    assert CommandAborted("MoveJoints") in rig.evrs
    assert not rig.outputs.drive.power_on.any()


@pytest.mark.parametrize("joint", slow_but(Joint, Joint.ELBOW, Joint.TURRET))
def test_a_motor_that_lags_by_what_friction_takes_has_not_stalled(joint):
    """From the very start of the motion to its end, and on the way to a contact."""
    commands = (MoveJoints(floats(lab.START + 0.02)), MoveJoints(floats(lab.START)))
    for command in commands:
        rig = Rig(lab.CONFIG, start_rad=lab.START)
        rig.cycle(command)
        while rig.outputs.joint.busy:
            rate = rig.outputs.drive.setpoint_rate_rad_s[joint]
            behind = lab.BOUNDS.stall_error_rad * np.sign(rate) * (abs(rate) > 1e-6)
            lag = lab.resolver_off(rig, joint, -0.9 * behind)  # the output lags as its motor does
            rig.cycle(**lab.off_set_point(rig, joint, -0.9 * behind), **lag)
        assert not lab.found(rig, faults.Fault)
    rig = lab.in_guarded_motion()
    for _ in range(100):
        rig.cycle(**lab.off_set_point(rig, joint, -0.9 * lab.BOUNDS.stall_error_rad))
    assert not lab.found(rig, faults.Fault)


def test_a_motor_that_does_not_come_to_rest_is_a_fault_after_its_time():
    rig = lab.moving(MoveJoints(floats(lab.START + 0.002)))
    settle_error = lab.CONFIG.params.motion.settle_error_rad
    cycles = 0
    while rig.outputs.joint.busy and cycles < 2000:
        rig.cycle(**lab.off_set_point(rig, Joint.TURRET, 3 * settle_error))
        cycles += 1
    (evr,) = lab.found(rig, faults.NotSettled)
    assert evr.joint is Joint.TURRET
    assert evr.error_rad == pytest.approx(3 * settle_error, rel=0.2)
    assert lab.REFUSED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert cycles > lab.CONFIG.settle_timeout_ticks
