"""The last stage answers a fault once, and says of a standing fault what was not said yet."""

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault, MoveJoints
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, FaultResponse
from fsw.dictionary.faults import (
    ContactInFreeSpace,
    ContactLost,
    GravityImplausible,
    NoContact,
    OverCurrent,
    OverTemperature,
    SensorNotFinite,
)
from fsw.dictionary.joints import Joint, Switch, Tool
from fsw.dictionary.modes import Mode
from fsw.executive.modes import TRANSITIONS, Event
from fsw.executive.sequence import Sequence
from fsw.motion.move import Phase
from fsw.protect.guard import Guarded, StandingFault, guard, kind_of
from fsw.state import last_setpoint
from tests.fsw.rig import Rig, config_of, facing, floats

CONFIG = config_of()
START = facing(CONFIG, Tool.APXS)
RESPONDED = FaultResponse("BRAKE_AND_REFUSE")
NO_NUMBER = {"current_A": [np.nan] * 5}
NO_GRAVITY = {"gravity_R_m_s2": [0.0, 0.0, 0.0]}


def moving():
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(MoveJoints(floats(START + 0.05)))
    rig.evrs.clear()
    return rig


def guarded(rig, before, *found):
    return guard(CONFIG, before, last_setpoint(rig.state), rig.state.joints, found)


@pytest.mark.parametrize("mode", Mode)
def test_what_is_no_fault_changes_nothing_and_is_reported(mode):
    rig = moving()
    after = guarded(rig, Guarded(mode, rig.state.move, None, None, ()), CommandCompleted("Stop"))
    assert (after.mode, after.move, after.fault) == (mode, rig.state.move, None)
    assert after.evrs == (CommandCompleted("Stop"),)


@pytest.mark.parametrize("mode", [mode for mode in Mode if (mode, Event.STOP) in TRANSITIONS])
def test_a_stop_leaves_the_mode_to_the_end_of_the_move_and_drops_the_sequence(mode):
    rig = moving()
    sequence, lost = Sequence("CalibrateAll", ()), ContactLost(Tool.DRILL)
    after = guarded(rig, Guarded(mode, rig.state.move, sequence, None, ()), lost)
    assert (after.mode, after.sequence, after.fault) == (mode, None, None)
    assert after.move.stopped
    assert after.move.end_mode is TRANSITIONS[mode, Event.STOP]
    assert after.evrs == (lost, FaultResponse("STOP_AND_BRAKE"), CommandAborted("CalibrateAll"))


def test_power_off_is_a_brake_without_power():
    rig = moving()
    before = Guarded(Mode.FREE_SPACE, rig.state.move, None, None, ())
    braked = guarded(rig, before, NoContact(0.1))
    after = guarded(rig, before, OverTemperature(Joint.WRIST, 100.0, 90.0))
    assert braked.move.active.all()
    assert not after.move.active.any()
    assert after.move.phase is braked.move.phase is Phase.BRAKE
    assert after.mode is Mode.FAULTED
    assert after.evrs[-1] == FaultResponse("POWER_OFF")


@pytest.mark.parametrize(
    ("mode", "may_touch"),
    [(Mode.FREE_SPACE, False), (Mode.GUARDED, True), (Mode.RETRACTING, True), (Mode.PRELOAD, True)],
)
def test_an_arm_may_touch_where_it_was_to_touch_and_where_it_did(mode, may_touch):
    assert StandingFault(mode, frozenset()).may_touch is may_touch
    touched = frozenset({kind_of(ContactInFreeSpace(Switch.DRT_1))})
    assert StandingFault(mode, touched).may_touch


@pytest.mark.parametrize("mode", Mode)
def test_a_fault_brakes_the_move_and_remembers_where_it_happened(mode):
    rig = moving()
    found = (NoContact(0.1), CommandCompleted("Stop"))
    after = guarded(rig, Guarded(mode, rig.state.move, None, None, ()), *found)
    assert after.mode is Mode.FAULTED
    assert after.move.phase is Phase.BRAKE
    assert after.fault == StandingFault(mode, frozenset({(NoContact, None), (CommandCompleted, None)}))
    assert after.evrs == (*found, RESPONDED)


def test_a_standing_fault_is_not_answered_again_but_what_is_new_is_reported_once():
    rig = moving()
    first = guarded(rig, Guarded(Mode.FREE_SPACE, rig.state.move, None, None, ()), NoContact(0.1))
    before = Guarded(first.mode, first.move, None, first.fault, ())
    drew = OverCurrent(Joint.WRIST, 3.0, 2.85)
    assert guarded(rig, before, NoContact(0.2)) is before
    after = guarded(rig, before, NoContact(0.2), drew)
    assert after.evrs == (drew,)
    assert (after.mode, after.move) == (before.mode, before.move)
    reported = frozenset({(NoContact, None), (OverCurrent, Joint.WRIST)})
    assert after.fault == StandingFault(Mode.FREE_SPACE, reported)
    assert guarded(rig, Guarded(after.mode, after.move, None, after.fault, ()), drew).evrs == ()


def test_each_kind_of_trouble_is_said_once_from_fault_to_clearing():
    rig = moving()
    for _ in range(10):
        rig.cycle(**NO_NUMBER)
        rig.cycle(**NO_GRAVITY)
        rig.cycle(winding_C=[np.inf] * 5)
    kinds = [type(evr) for evr in rig.evrs]
    for kind in (GravityImplausible, FaultResponse, CommandAborted):
        assert kinds.count(kind) == 1
    # once for each sensor
    unreadable = [evr.sensor for evr in rig.evrs if isinstance(evr, SensorNotFinite)]
    assert len(unreadable) == len(set(unreadable)) == 2
    assert rig.outputs.drive.power_on.any() is np.False_
    rig.evrs.clear()
    rig.cycle(ClearFault())
    rig.cycle(**NO_GRAVITY)
    assert any(isinstance(evr, GravityImplausible) for evr in rig.evrs)
    assert RESPONDED in rig.evrs
