"""The mode machine, walked: every mode with every event."""

import pytest

from fsw.dictionary.modes import Mode
from fsw.executive.modes import TRANSITIONS, Event, after

NO = None
# columns in the order of Event: MOVE_FREE, MOVE_GUARDED, MOVE_BACK, DONE, FAULT, CLEAR
TABLE = {
    Mode.STOWED: (Mode.FREE_SPACE, NO, NO, NO, Mode.FAULTED, NO),
    Mode.DEPLOYED: (Mode.FREE_SPACE, Mode.GUARDED, Mode.RETRACTING, NO, Mode.FAULTED, NO),
    Mode.FREE_SPACE: (NO, NO, NO, Mode.DEPLOYED, Mode.FAULTED, NO),
    Mode.GUARDED: (NO, Mode.GUARDED, Mode.RETRACTING, Mode.GUARDED, Mode.FAULTED, NO),
    Mode.RETRACTING: (NO, NO, NO, Mode.DEPLOYED, Mode.FAULTED, NO),
    Mode.FAULTED: (NO, NO, NO, NO, Mode.FAULTED, Mode.DEPLOYED),
}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("event", Event)
def test_every_event_in_every_mode(mode, event):
    assert after(mode, event) is TABLE[mode][event]


def test_the_table_speaks_of_every_mode_and_event():
    assert set(TABLE) == set(Mode)
    assert all(len(row) == len(Event) for row in TABLE.values())


def test_any_mode_can_fault_and_only_a_cleared_fault_leaves_it():
    assert all(after(mode, Event.FAULT) is Mode.FAULTED for mode in Mode)
    ways_out = [event for event in Event if after(Mode.FAULTED, event) not in (None, Mode.FAULTED)]
    assert ways_out == [Event.CLEAR]


def test_every_mode_is_left_by_some_event_and_all_but_stowed_are_reached_by_one():
    assert {mode for mode, _ in TRANSITIONS} == set(Mode)
    assert set(TRANSITIONS.values()) == set(Mode) - {Mode.STOWED}
