"""Modes: every event and every command in every mode, and what protection does to them."""

from itertools import product
from typing import get_args

import pytest

from fsw.dictionary import evrs
from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
    Dock,
    GuardedMove,
    MoveJoint,
    Preload,
    Retract,
    SetParam,
    SetTilt,
    Stop,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.faults import ContactLost, NoContact, OverTemperature
from fsw.executive.context import EVENT_OF, TRANSITIONS, ModeEvent, next_mode
from fsw.executive.protection import MoveOutcome, apply_decision
from fsw.motion.move import Phase
from fsw.protect.responses import decide
from fsw.state import Sequence, last_setpoint
from tests.fsw.executive import lab
from tests.fsw.executive.faults.lab import moving
from tests.fsw.executive.lab import COMMANDS, RIGS, TOUCHED, TOUCHING
from tests.fsw.rig import config_of

NOT_CALIBRATED = "not calibrated: {}; until it is, a joint may only look for its hardstop"
NO_MOVES = (SetTilt, SetParam, Stop)
"""Commands without a move; they complete at once if nothing is under way."""


def in_mode(name: str, *allowed: type) -> dict[type, str]:
    """Return the refusals in a mode without a fault: all commands but the allowed ones."""
    refused = {kind: f"not allowed in mode {name}" for kind in COMMANDS if kind not in (*allowed, *NO_MOVES)}
    return refused | {ClearFault: "no fault stands"}


def under_way(name: str, clearing: str = "no fault stands") -> dict[type, str]:
    """Return the refusals while a command is under way: all commands but a stop."""
    return {kind: f"{name} is under way" for kind in COMMANDS if kind is not Stop} | {ClearFault: clearing}


FAULT = {kind: "a fault stands; clear it first" for kind in COMMANDS if kind not in (Stop, ClearFault)}


REFUSED = {
    lab.stowed: in_mode("STOWED", Unstow),
    lab.uncalibrated: {
        kind: NOT_CALIBRATED.format("azimuth, elevation, elbow, wrist, turret")
        for kind in COMMANDS
        if kind not in (Calibrate, CalibrateAll, *NO_MOVES)
    }
    | {MoveJoint: NOT_CALIBRATED.format("wrist"), ClearFault: "no fault stands"},
    lab.deployed: {
        Unstow: "not allowed in mode DEPLOYED",
        Preload: "not allowed in mode DEPLOYED",
        ToolChange: "drill touches nothing: there is no spot to go back to",
        ClearFault: "no fault stands",
    },
    lab.planning: {
        kind: reason.replace("under way", "being planned") for kind, reason in under_way("MoveJoints").items()
    },
    lab.moving_free: under_way("MoveJoints"),
    lab.guarded_moving: under_way("GuardedMove"),
    lab.guarded_in_contact: in_mode("GUARDED", GuardedMove, Retract, Preload, ToolChange, Dock)
    | {Dock: "apxs is the tool that may touch; retract it first"},
    lab.retracting: under_way("Retract"),
    lab.calibrating: under_way("Calibrate"),
    lab.preloading: under_way("Preload"),
    lab.preloaded: in_mode("PRELOAD", Preload),
    lab.being_stopped_by_a_fault: FAULT | {ClearFault: "the arm is still being stopped"},
    lab.faulted: FAULT,
}
"""Refused commands and their reasons by rig; all other commands are accepted."""


def test_the_table_speaks_of_every_mode_and_every_command():
    assert {make().state.mode for make in RIGS} == set(Mode)
    assert set(REFUSED) == set(RIGS)
    assert set(COMMANDS) == set(get_args(Command))


@pytest.mark.parametrize(
    ("make_rig", "kind"), list(product(RIGS, COMMANDS)), ids=lambda value: getattr(value, "__name__", None)
)
def test_every_command_in_every_situation(make_rig, kind):
    rig = make_rig()
    before, name = rig.state, kind.__name__
    reason, readings = REFUSED[make_rig].get(kind), TOUCHED if make_rig in TOUCHING else {}
    (rig.cycle if reason else rig.begin)(COMMANDS[kind](rig), **readings)
    refused = [evr for evr in rig.evrs if isinstance(evr, evrs.CommandRefused)]
    if reason:
        assert refused == [evrs.CommandRefused(name, reason)]
        assert rig.state.mode is before.mode
        assert evrs.CommandAccepted(name) not in rig.evrs
        assert (rig.state.move is None) is (before.move is None)
        assert rig.state.joints.reference is before.joints.reference
        kept = ("sequence", "fault", "changed_config", "tool")
        assert all(getattr(rig.state, field) is getattr(before, field) for field in kept)
    else:
        assert not refused
        assert evrs.CommandAccepted(name) in rig.evrs or evrs.CommandCompleted(name) in rig.evrs
        if kind in EVENT_OF:
            assert rig.state.mode is next_mode(before.mode, EVENT_OF[kind])


NO = None
STOW, DEPL, FREE, GUARD, BACK, FAULT, PRESS, PLAN = Mode
# columns in the order of ModeEvent: UNSTOW, MOVE_FREE, MOVE_GUARDED, MOVE_BACK, DONE, FAULT, CLEAR,
# CLEAR_STOWED, CLEAR_TOUCHING, STOP, STOP_STOWED, DONE_STOWED, PRESS, DONE_RELEASED, CLEAR_PRESSED, PLAN
TABLE = {
    Mode.STOWED: (FREE, NO, NO, NO, NO, FAULT, NO, NO, NO, NO, NO, NO, NO, NO, NO, PLAN),
    Mode.DEPLOYED: (NO, FREE, GUARD, BACK, NO, FAULT, NO, NO, NO, NO, NO, NO, NO, NO, NO, PLAN),
    Mode.FREE_SPACE: (NO, NO, NO, NO, DEPL, FAULT, NO, NO, NO, DEPL, STOW, STOW, NO, NO, NO, NO),
    Mode.GUARDED: (NO, NO, GUARD, BACK, GUARD, FAULT, NO, NO, NO, GUARD, NO, NO, PRESS, NO, NO, PLAN),
    Mode.RETRACTING: (NO, NO, NO, NO, DEPL, FAULT, NO, NO, NO, GUARD, NO, NO, NO, NO, NO, NO),
    Mode.FAULTED: (NO, NO, NO, NO, NO, FAULT, DEPL, STOW, GUARD, NO, NO, NO, NO, NO, PRESS, NO),
    Mode.PRELOAD: (NO, NO, NO, NO, PRESS, FAULT, NO, NO, NO, PRESS, NO, NO, PRESS, GUARD, NO, PLAN),
    Mode.PLANNING: (NO, NO, NO, NO, NO, FAULT, NO, NO, NO, NO, NO, NO, NO, NO, NO, NO),
}


def test_every_event_in_every_mode():
    assert {mode: tuple(next_mode(mode, event) for event in ModeEvent) for mode in Mode} == TABLE


CONFIG = config_of()


def respond(rig, before, *found):
    joints, last_rad = rig.state.joints, last_setpoint(rig.state)
    decision = decide(CONFIG.protection, before.mode, before.fault, found, joints.motor_rad, last_rad)
    return apply_decision(CONFIG, before, decision, joints)


@pytest.mark.parametrize("mode", [mode for mode in Mode if (mode, ModeEvent.STOP) in TRANSITIONS])
def test_a_stop_leaves_the_mode_to_the_end_of_the_move_and_drops_the_sequence(mode):
    rig = moving()
    sequence, lost = Sequence("CalibrateAll", ()), ContactLost("drill")
    after = respond(rig, MoveOutcome(mode, None, rig.state.move, sequence, None, ()), lost)
    assert (after.mode, after.sequence, after.fault) == (mode, None, None)
    assert after.move.plan.stopped
    assert after.move.plan.end_mode is TRANSITIONS[mode, ModeEvent.STOP]
    assert after.evrs == (lost, evrs.FaultResponse("STOP_AND_BRAKE"), evrs.CommandAborted("CalibrateAll"))


def test_power_off_is_a_brake_without_power():
    rig = moving()
    before = MoveOutcome(Mode.FREE_SPACE, None, rig.state.move, None, None, ())
    braked = respond(rig, before, NoContact(0.1))
    after = respond(rig, before, OverTemperature(Joint.WRIST, 100.0, 90.0))
    assert braked.move.plan.active.all()
    assert not after.move.plan.active.any()
    assert after.move.phase is braked.move.phase is Phase.BRAKE
    assert after.mode is Mode.FAULTED
    assert after.evrs[-1] == evrs.FaultResponse("POWER_OFF")
