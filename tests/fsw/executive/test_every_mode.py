"""Every command in every mode, at rest or moving: accepted, or refused with a reason and nothing changed."""

from itertools import product
from typing import get_args

import pytest

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
    Stop,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAccepted, CommandCompleted, CommandRefused
from fsw.executive.context import EVENT_OF, next_mode
from sim.scenario.rehearsal import COMMAND_EVENTS
from tests.fsw.executive import lab
from tests.fsw.executive.lab import COMMANDS, RIGS, TOUCHED, TOUCHING

NOT_CALIBRATED = "not calibrated: {}; until it is, a joint may only look for its hardstop"
NO_MOVES = [kind for kind, events in COMMAND_EVENTS.items() if not events]
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
    rig.evrs.clear()
    rig.cycle(COMMANDS[kind](rig), **(TOUCHED if make_rig in TOUCHING else {}))
    reason = REFUSED[make_rig].get(kind)
    refused = [evr for evr in rig.evrs if isinstance(evr, CommandRefused)]
    if reason:
        assert refused == [CommandRefused(name, reason)]
        assert rig.state.mode is before.mode
        assert CommandAccepted(name) not in rig.evrs
        assert (rig.state.move is None) is (before.move is None)
        assert rig.state.joints.reference is before.joints.reference
        kept = ("sequence", "fault", "changed_config", "tool")
        assert all(getattr(rig.state, field) is getattr(before, field) for field in kept)
    else:
        assert not refused
        assert CommandAccepted(name) in rig.evrs or CommandCompleted(name) in rig.evrs
        if kind in EVENT_OF:
            assert rig.state.mode is next_mode(before.mode, EVENT_OF[kind])
