"""Check of sequences against the mode table: what flight software would refuse is refused before the run."""

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
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Preload,
    Process,
    Retract,
    SetTilt,
    Stop,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Joint, Mode
from sim.scenario.rehearsal import COMMAND_EVENTS, find_refusals, modes_after

UP = (0.0, 0.0, 1.0)
HERE = (2.0, 0.0, 0.8)
MOVE = MoveTool("apxs", HERE, UP)
PLACE = PlaceTool("apxs", HERE, UP)
TOUCH = GuardedMove("apxs", HERE, UP)
CHANGE = ToolChange("mahli")
PRESS, RELEASE = Preload("apxs", 50.0), Preload("apxs", 0.0)
BACK = Retract("apxs", 0.1)

OTHERS = (MoveJoints((0.0,) * 5), MoveTeachPoint("box"), Calibrate(Joint.ELBOW))
FINE = {
    "a placement": (Mode.STOWED, (Unstow(), MOVE, PLACE, BACK, Stow())),
    "contact again and again": (Mode.DEPLOYED, (TOUCH, TOUCH, BACK, TOUCH)),
    "a tool change": (Mode.DEPLOYED, (PLACE, CHANGE, Retract("mahli", 0.1), MOVE)),
    "a tool that hovers": (Mode.DEPLOYED, (PLACE, ToolChange("mahli", hover_m=0.05), MOVE)),
    "a press": (Mode.DEPLOYED, (PLACE, PRESS, PRESS, RELEASE, BACK)),
    "a dock": (Mode.DEPLOYED, (Dock("box"), Preload("drill", 100.0), Preload("drill", 0.0))),
    "there and back": (Mode.STOWED, (Unstow(), Stow(), Unstow())),
    "joints": (Mode.DEPLOYED, (CalibrateAll(), MoveJoint(Joint.ELBOW, 1.0), Process("drill", UP, 1.0))),
    "settings anywhere": (Mode.STOWED, (SetTilt(0.0, 0.0), Stop(), Unstow(), SetTilt(0.0, 0.0))),
}

PRESSED_BY = "GUARDED_MOVE or PLACE_TOOL or DOCK"
REFUSED = [
    (Mode.STOWED, (MOVE,), "MOVE_TOOL is refused in mode STOWED; before it comes UNSTOW"),
    (Mode.STOWED, (Unstow(), Unstow()), "UNSTOW is refused in mode DEPLOYED; before it comes STOW"),
    (Mode.DEPLOYED, (TOUCH, Stow()), "STOW is refused in mode GUARDED; before it comes RETRACT"),
    (Mode.DEPLOYED, (MOVE, PRESS), f"PRELOAD is refused in mode DEPLOYED; before it comes {PRESSED_BY}"),
    (Mode.DEPLOYED, (PLACE, PRESS, BACK), "RETRACT is refused in mode PRELOAD; before it comes PRELOAD of"),
    (Mode.DEPLOYED, (CHANGE,), "TOOL_CHANGE is refused in mode DEPLOYED"),
    (Mode.DEPLOYED, (PLACE, MOVE), "MOVE_TOOL is refused in mode GUARDED; before it comes RETRACT"),
    (Mode.DEPLOYED, (PLACE, Retract("drill", 0.1)), "RETRACT: apxs is the tool that touches"),
    (Mode.DEPLOYED, (PLACE, CHANGE, BACK), "RETRACT: mahli is the tool that touches"),
    (Mode.DEPLOYED, (ClearFault(),), "no fault is known to stand"),
]
"""Sequences whose last command is refused."""


@pytest.mark.parametrize("case", FINE)
def test_what_flight_software_does_is_not_refused(case):
    start, commands = FINE[case]
    assert not list(find_refusals(commands, start))


@pytest.mark.parametrize(("start", "commands", "expected"), REFUSED)
def test_what_flight_software_refuses_is_told_with_its_number_and_what_comes_before(
    start, commands, expected
):
    ((found, problem),) = find_refusals(commands, start)
    assert found == len(commands)
    assert expected in problem


def test_every_command_has_its_events():
    assert set(COMMAND_EVENTS) == set(get_args(Command))


@pytest.mark.parametrize(
    "kind", [kind for kind in get_args(Command) if COMMAND_EVENTS[kind]], ids=lambda k: k.__name__
)
def test_every_command_that_changes_the_mode_can_begin_in_some_mode_and_not_in_another(kind):
    known = [command for _, commands in FINE.values() for command in commands]
    sample = next((command for command in [*known, ClearFault(), *OTHERS] if isinstance(command, kind)), None)
    assert sample is not None
    begins = {mode for mode in Mode if modes_after(frozenset({mode}), sample)}
    assert begins
    assert begins < set(Mode)


def test_after_a_fault_that_is_bound_to_come_motion_waits_for_the_fault_to_be_cleared():
    commands = (MOVE, PLACE, MOVE, SetTilt(0.0, 0.0), ClearFault(), MOVE)
    found = dict(find_refusals(commands, Mode.DEPLOYED, faulting=[1]))
    assert set(found) == {2, 3, 4}
    assert (
        found[2]
        == "PLACE_TOOL asks for motion while the fault of command 1 stands; put CLEAR_FAULT before it"
    )
    assert found[4] == "SET_TILT comes while the fault of command 1 stands; put CLEAR_FAULT before it"


def test_where_a_cleared_fault_leaves_the_arm_is_not_guessed_and_what_does_not_move_cannot_fault():
    for after_it in ((BACK,), (MOVE,), (Unstow(),), (RELEASE, BACK, MOVE)):
        assert not list(find_refusals((PLACE, ClearFault(), *after_it), Mode.DEPLOYED, faulting=[1]))
    assert not list(find_refusals((SetTilt(0.0, 0.0), MOVE), Mode.DEPLOYED, faulting=[1]))


def test_a_fault_that_may_end_a_command_may_be_cleared_and_need_not_come():
    cleared, ignored = (MOVE, ClearFault(), MOVE), (MOVE, MOVE)
    assert list(find_refusals(cleared, Mode.DEPLOYED, troubled=(1,))) == []
    assert list(find_refusals(ignored, Mode.DEPLOYED, troubled=(1,))) == []
    ((number, problem),) = find_refusals((Stop(), ClearFault()), Mode.DEPLOYED, troubled=(1,))
    assert number == 2
    assert problem.startswith("CLEAR_FAULT: no fault is known to stand")
