"""A fault and the command that clears it in one cycle."""

import numpy as np

from fsw.dictionary import evrs, faults
from fsw.dictionary.commands import ClearFault, MoveJoints, Stop
from fsw.dictionary.enums import Mode
from tests.fsw.executive.faults import lab
from tests.fsw.rig import Rig, alive, floats

PERSISTENCE = lab.BOUNDS.reading_persistence


def frozen(rig):
    """Currents that stay the same, and nothing else that does."""
    return {"current_A": np.ones(5), "resolver_rad": rig.resolver_rad()}


def test_a_fault_that_is_still_there_is_not_cleared_whatever_else_is_commanded():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    while rig.state.mode is not Mode.FAULTED:
        rig.cycle(**frozen(rig))
    rig.evrs.clear()
    rig.cycle(Stop(), ClearFault(), MoveJoints(floats(lab.START)), **frozen(rig))
    refused, stopped, move = rig.evrs
    assert refused.command == "ClearFault"
    assert refused.reason.startswith("a fault was found in the same cycle: current_A reads the same")
    assert stopped == evrs.CommandCompleted("Stop")
    assert move == evrs.CommandRefused("MoveJoints", "a fault stands; clear it first")
    assert rig.state.mode is Mode.FAULTED
    assert rig.state.fault is not None
    rig.cycle(ClearFault())
    assert evrs.FaultCleared() in rig.evrs
    assert rig.state.mode is Mode.DEPLOYED


def test_a_fault_that_is_found_in_the_cycle_of_the_command_comes_after_its_refusal():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.cycle()
    for _ in range(PERSISTENCE - 1):
        rig.cycle(gravity_R_m_s2=[np.nan] * 3)
    rig.evrs.clear()
    rig.cycle(ClearFault(), gravity_R_m_s2=[np.nan] * 3)
    assert rig.evrs[0] == evrs.CommandRefused("ClearFault", "no fault stands")
    assert isinstance(rig.evrs[1], faults.ReadingImplausible)
    assert rig.evrs[2] == lab.REFUSED


def test_a_reading_out_of_range_is_not_cleared_and_names_its_sensor():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.cycle()
    rig.go_blind()
    rig.evrs.clear()
    rig.cycle(ClearFault(), winding_C=np.full(5, np.nan) + alive(rig.cycles))
    assert rig.evrs == [evrs.CommandRefused("ClearFault", "out of range: winding_C")]
    assert rig.state.mode is Mode.FAULTED
