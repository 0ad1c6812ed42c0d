"""A rover that slips while its arm moves."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Mode
from fsw.dictionary.faults import Fault, TiltChanged
from tests.fsw.executive.faults.lab import BOUNDS, CONFIG, REFUSED, START, braked, found, moving
from tests.fsw.rig import MARS_R_m_s2, Rig, alive, floats

LONG = MoveJoints(floats(START + 0.3))


def turned(angle_rad, about, pull=1.0):
    """Gravity turned about a level axis of the rover."""
    level = np.array([np.cos(about), np.sin(about), 0.0])
    g = np.linalg.norm(MARS_R_m_s2) * pull
    return g * (np.cos(angle_rad) * np.array([0, 0, 1.0]) + np.sin(angle_rad) * level)


@pytest.mark.parametrize("about", [0.0, 1.0, 2.5, 4.0])
def test_gravity_that_turns_during_a_move_by_more_than_its_bound_stops_the_arm(about):
    for share, said in ((0.98, False), (1.05, True)):
        rig = moving(LONG)
        for k in range(600):
            rig.cycle(gravity_R_m_s2=turned(share * BOUNDS.tilt_rad, about) + alive(k))
        assert bool(found(rig, Fault)) is said
        if said:
            (evr,) = found(rig, TiltChanged)
            assert BOUNDS.tilt_rad < evr.turned_rad < share * BOUNDS.tilt_rad
            assert evr.bound_rad == BOUNDS.tilt_rad
            assert REFUSED in rig.evrs
            assert rig.state.mode is Mode.FAULTED
            assert braked(rig)


def test_a_large_turn_is_said_as_soon_as_the_filter_shows_it_and_its_persistence_is_over():
    rig = moving(LONG)
    cycles = 0
    while not found(rig, TiltChanged):
        rig.cycle(gravity_R_m_s2=turned(0.5, 0.0) + alive(rig.cycles))
        cycles += 1
    assert BOUNDS.tilt_persistence <= cycles <= BOUNDS.tilt_persistence + 2


def test_a_turn_that_goes_back_is_no_change():
    rig = moving(LONG)
    for k in range(200):
        rig.cycle(gravity_R_m_s2=turned(0.1 * (-1) ** (k // 2), 0.0) + alive(k))
    assert not found(rig, Fault)


def test_gravity_may_turn_between_moves_and_the_next_move_begins_from_there():
    rig = Rig(CONFIG, start_rad=START)
    rig.run(MoveJoints(floats(START + 0.01)))
    for k in range(600):
        rig.cycle(gravity_R_m_s2=turned(0.2, 0.3) + alive(k))
    rig.cycle(MoveJoints(floats(START)), gravity_R_m_s2=turned(0.2, 0.3))
    while rig.outputs.joint.busy:
        rig.cycle(gravity_R_m_s2=turned(0.2, 0.3) + alive(rig.cycles))
    assert not found(rig, Fault)


def test_only_the_direction_counts():
    rig = moving(LONG)
    for k in range(600):
        rig.cycle(gravity_R_m_s2=turned(0.0, 0.0, pull=2.0) + alive(k))
    assert not found(rig, TiltChanged)
