"""The mode machine, walked: every mode with every event."""

import pytest

from fsw.dictionary.enums import Mode
from fsw.executive.modes import TRANSITIONS, Event, after

NO = None
STOW, DEPL, FREE, GUARD, BACK, FAULT, PRESS = Mode
# columns in the order of Event: UNSTOW, MOVE_FREE, MOVE_GUARDED, MOVE_BACK, DONE, FAULT,
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
MOVES = {Event.UNSTOW, Event.MOVE_FREE, Event.MOVE_GUARDED, Event.MOVE_BACK, Event.PRESS}
CLEARING = {Event.CLEAR, Event.CLEAR_STOWED, Event.CLEAR_TOUCHING, Event.CLEAR_PRESSED}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("event", Event)
def test_every_event_in_every_mode(mode, event):
    assert after(mode, event) is TABLE[mode][event]


def test_the_table_speaks_of_every_mode_and_event():
    assert set(TABLE) == set(Mode)
    assert all(len(row) == len(Event) for row in TABLE.values())


def test_any_mode_can_fault_and_only_a_cleared_fault_leaves_it():
    assert all(after(mode, Event.FAULT) is Mode.FAULTED for mode in Mode)
    ways_out = {event for event in Event if after(Mode.FAULTED, event) not in (None, Mode.FAULTED)}
    assert ways_out == CLEARING
    assert all(after(mode, event) is None for mode in Mode for event in CLEARING if mode is not Mode.FAULTED)


def test_a_stowed_arm_moves_only_by_unstowing_and_only_a_stowed_arm_unstows():
    assert {event for event in MOVES if after(Mode.STOWED, event) is not None} == {Event.UNSTOW}
    assert {mode for mode in Mode if after(mode, Event.UNSTOW) is not None} == {Mode.STOWED}


def test_every_move_ends_somewhere():
    moving = {after(mode, event) for mode in Mode for event in MOVES} - {None}
    assert all(after(mode, Event.DONE) is not None for mode in moving)


def test_exactly_the_modes_in_which_an_arm_moves_can_be_stopped():
    moving = {after(mode, event) for mode in Mode for event in MOVES} - {None}
    assert {mode for mode in Mode if after(mode, Event.STOP) is not None} == moving


def test_a_stop_never_takes_an_arm_that_may_touch_into_free_space():
    assert {after(mode, Event.STOP) for mode in (Mode.GUARDED, Mode.RETRACTING)} == {Mode.GUARDED}


def test_every_mode_is_left_by_some_event_and_reached_by_another():
    for mode in Mode:
        assert any(start is mode and end is not mode for (start, _), end in TRANSITIONS.items())
        assert any(start is not mode and end is mode for (start, _), end in TRANSITIONS.items())
