"""Mode machine: every event in every mode, and properties of the table as a whole."""

import pytest

from fsw.dictionary.enums import Mode
from fsw.executive.context import TRANSITIONS, ModeEvent, next_mode

NO = None
STOW, DEPL, FREE, GUARD, BACK, FAULT, PRESS = Mode
# columns in the order of ModeEvent: UNSTOW, MOVE_FREE, MOVE_GUARDED, MOVE_BACK, DONE, FAULT,
# CLEAR, CLEAR_STOWED, CLEAR_TOUCHING, STOP, STOP_STOWED, DONE_STOWED, PRESS, DONE_RELEASED, CLEAR_PRESSED
TABLE = {
    Mode.STOWED: (FREE, NO, NO, NO, NO, FAULT, NO, NO, NO, NO, NO, NO, NO, NO, NO),
    Mode.DEPLOYED: (NO, FREE, GUARD, BACK, NO, FAULT, NO, NO, NO, NO, NO, NO, NO, NO, NO),
    Mode.FREE_SPACE: (NO, NO, NO, NO, DEPL, FAULT, NO, NO, NO, DEPL, STOW, STOW, NO, NO, NO),
    Mode.GUARDED: (NO, NO, GUARD, BACK, GUARD, FAULT, NO, NO, NO, GUARD, NO, NO, PRESS, NO, NO),
    Mode.RETRACTING: (NO, NO, NO, NO, DEPL, FAULT, NO, NO, NO, GUARD, NO, NO, NO, NO, NO),
    Mode.FAULTED: (NO, NO, NO, NO, NO, FAULT, DEPL, STOW, GUARD, NO, NO, NO, NO, NO, PRESS),
    Mode.PRELOAD: (NO, NO, NO, NO, PRESS, FAULT, NO, NO, NO, PRESS, NO, NO, PRESS, GUARD, NO),
}
MOVES = {ModeEvent.UNSTOW, ModeEvent.MOVE_FREE, ModeEvent.MOVE_GUARDED, ModeEvent.MOVE_BACK, ModeEvent.PRESS}
CLEARING = {ModeEvent.CLEAR, ModeEvent.CLEAR_STOWED, ModeEvent.CLEAR_TOUCHING, ModeEvent.CLEAR_PRESSED}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("event", ModeEvent)
def test_every_event_in_every_mode(mode, event):
    assert next_mode(mode, event) is TABLE[mode][event]


def test_any_mode_can_fault_and_only_a_cleared_fault_leaves_it():
    assert all(next_mode(mode, ModeEvent.FAULT) is Mode.FAULTED for mode in Mode)
    ways_out = {event for event in ModeEvent if next_mode(Mode.FAULTED, event) not in (None, Mode.FAULTED)}
    assert ways_out == CLEARING
    assert all(
        next_mode(mode, event) is None for mode in Mode for event in CLEARING if mode is not Mode.FAULTED
    )


def test_a_stowed_arm_moves_only_by_unstowing_and_only_a_stowed_arm_unstows():
    assert {event for event in MOVES if next_mode(Mode.STOWED, event) is not None} == {ModeEvent.UNSTOW}
    assert {mode for mode in Mode if next_mode(mode, ModeEvent.UNSTOW) is not None} == {Mode.STOWED}


def test_exactly_the_modes_in_which_an_arm_moves_can_be_stopped_and_every_move_ends_somewhere():
    moving = {next_mode(mode, event) for mode in Mode for event in MOVES} - {None}
    assert all(next_mode(mode, ModeEvent.DONE) is not None for mode in moving)
    assert {mode for mode in Mode if next_mode(mode, ModeEvent.STOP) is not None} == moving


def test_every_mode_is_left_by_some_event_and_reached_by_another():
    for mode in Mode:
        assert any(start is mode and end is not mode for (start, _), end in TRANSITIONS.items())
        assert any(start is not mode and end is mode for (start, _), end in TRANSITIONS.items())
