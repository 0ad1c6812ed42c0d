"""Decisions of protection change mode, move and sequence; a standing fault has one response only."""

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, FaultResponse
from fsw.dictionary.faults import ContactLost, GravityImplausible, NoContact, OverTemperature, SensorNotFinite
from fsw.executive.context import TRANSITIONS, ModeEvent
from fsw.executive.protection import MoveOutcome, apply_decision
from fsw.motion.move import Phase
from fsw.protect.responses import StandingFault, decide
from fsw.state import Sequence, last_setpoint
from tests.fsw.executive.faults.lab import moving
from tests.fsw.rig import config_of, facing

CONFIG = config_of()
START = facing(CONFIG, "apxs")
RESPONDED = FaultResponse("BRAKE_AND_REFUSE")
NO_NUMBER = {"current_A": [np.nan] * 5}
NO_GRAVITY = {"gravity_R_m_s2": [0.0, 0.0, 0.0]}


def respond(rig, before, *found):
    joints, last_rad = rig.state.joints, last_setpoint(rig.state)
    decision = decide(CONFIG.protection, before.mode, before.fault, found, joints.motor_rad, last_rad)
    return apply_decision(CONFIG, before, decision, joints)


@pytest.mark.parametrize("mode", [mode for mode in Mode if (mode, ModeEvent.STOP) in TRANSITIONS])
def test_a_stop_leaves_the_mode_to_the_end_of_the_move_and_drops_the_sequence(mode):
    rig = moving()
    sequence, lost = Sequence("CalibrateAll", ()), ContactLost("drill")
    after = respond(rig, MoveOutcome(mode, rig.state.move, sequence, None, ()), lost)
    assert (after.mode, after.sequence, after.fault) == (mode, None, None)
    assert after.move.plan.stopped
    assert after.move.plan.end_mode is TRANSITIONS[mode, ModeEvent.STOP]
    assert after.evrs == (lost, FaultResponse("STOP_AND_BRAKE"), CommandAborted("CalibrateAll"))


def test_power_off_is_a_brake_without_power():
    rig = moving()
    before = MoveOutcome(Mode.FREE_SPACE, rig.state.move, None, None, ())
    braked = respond(rig, before, NoContact(0.1))
    after = respond(rig, before, OverTemperature(Joint.WRIST, 100.0, 90.0))
    assert braked.move.plan.active.all()
    assert not after.move.plan.active.any()
    assert after.move.phase is braked.move.phase is Phase.BRAKE
    assert after.mode is Mode.FAULTED
    assert after.evrs[-1] == FaultResponse("POWER_OFF")


@pytest.mark.parametrize("mode", Mode)
def test_only_a_fault_brakes_the_move_and_where_it_happened_is_remembered(mode):
    rig = moving()
    before, found = (
        MoveOutcome(mode, rig.state.move, None, None, ()),
        (NoContact(0.1), CommandCompleted("Stop")),
    )
    after = respond(rig, before, *found)
    assert after.mode is Mode.FAULTED
    assert after.move.phase is Phase.BRAKE
    assert after.fault == StandingFault(mode, frozenset({(NoContact, None), (CommandCompleted, None)}))
    assert after.evrs == (*found, RESPONDED)
    calm = respond(rig, before, found[1])
    assert (calm.mode, calm.move, calm.fault, calm.evrs) == (mode, rig.state.move, None, found[1:])


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
