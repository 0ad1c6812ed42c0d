"""Whether sensors live, and whether flight software is called as often as it should be."""

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault, MoveJoints
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, CyclesSkipped
from fsw.dictionary.faults import CycleCountWrong, CyclesMissed, Fault, SensorFrozen
from tests.fsw.executive.faults.lab import BOUNDS, CONFIG, REFUSED, START, STOPPED, braked, found, moving
from tests.fsw.rig import MARS_R_m_s2, Rig, alive, floats

LIVELY = {"resolver_rad": 5, "current_A": 5, "gravity_R_m_s2": 3}


def stuck_at(rig, name, place):
    """A reading of which one number is what it was in the first cycle, and the others live."""
    quiet = {"resolver_rad": rig.resolver_rad(), "current_A": np.zeros(5), "gravity_R_m_s2": MARS_R_m_s2}
    live = quiet[name] + alive(rig.cycles + 1)
    rig.stood = getattr(rig, "stood", live + 1e-9)
    return {name: np.where(np.arange(live.size) == place, rig.stood, live)}


@pytest.mark.parametrize(("name", "place"), [(name, k) for name, size in LIVELY.items() for k in range(size)])
def test_one_number_that_stays_the_same_to_the_last_bit_is_a_frozen_sensor_after_its_persistence(name, place):
    rig = Rig(CONFIG, start_rad=START)
    rig.evrs.clear()
    for _ in range(1 + BOUNDS.frozen_persistence - 1):
        rig.cycle(**stuck_at(rig, name, place))
        assert not found(rig, Fault)
    rig.cycle(**stuck_at(rig, name, place))
    assert rig.evrs[:2] == [SensorFrozen(name, BOUNDS.frozen_persistence), REFUSED]
    assert rig.state.mode is Mode.FAULTED


def test_a_sensor_that_freezes_in_a_move_stops_the_arm():
    rig = moving(MoveJoints(floats(START + 0.2)))
    for _ in range(BOUNDS.frozen_persistence + 1):
        rig.cycle(current_A=np.full(5, 0.4))
    assert found(rig, SensorFrozen) == [SensorFrozen("current_A", BOUNDS.frozen_persistence)]
    assert braked(rig)


def test_all_frozen_sensors_are_named_once_each_and_again_after_clearing():
    rig = Rig(CONFIG, start_rad=START)
    frozen = {name: np.ones(size) for name, size in LIVELY.items()}
    frozen["gravity_R_m_s2"] = MARS_R_m_s2
    for _ in range(2 * BOUNDS.frozen_persistence):
        rig.cycle(**frozen)
    assert [evr.sensor for evr in found(rig, SensorFrozen)] == list(LIVELY)
    rig.evrs.clear()
    rig.cycle(ClearFault(), **frozen)
    assert [evr.sensor for evr in found(rig, SensorFrozen)] == list(LIVELY)
    assert rig.state.mode is Mode.FAULTED


def test_a_reading_that_stands_for_a_while_and_then_lives_is_not_frozen():
    rig = moving()
    for _ in range(3):
        for _ in range(BOUNDS.frozen_persistence):
            rig.cycle(current_A=np.full(5, 0.1))
        rig.cycle()
    assert not found(rig, Fault)


def test_windings_and_encoders_that_read_the_same_may_be_alive():
    """Nothing flows, nothing turns."""
    rig = Rig(CONFIG, start_rad=START)
    for _ in range(3 * BOUNDS.frozen_persistence):
        rig.cycle()
    assert not found(rig, Fault)


def skip(rig, cycles):
    rig.cycles += cycles
    rig.cycle()


@pytest.mark.parametrize("cycles", range(1, BOUNDS.missed_cycles + 1))
def test_a_few_missed_cycles_are_reported_and_the_move_goes_on(cycles):
    rig = moving()
    skip(rig, cycles)
    assert rig.evrs == [CyclesSkipped(cycles)]
    rig.run()
    assert not found(rig, Fault)
    assert rig.state.mode is Mode.DEPLOYED


@pytest.mark.parametrize("more", [1, 100])
def test_more_missed_cycles_stop_the_move_which_may_be_commanded_again(more):
    rig = moving()
    skip(rig, BOUNDS.missed_cycles + more)
    assert rig.evrs == [CyclesMissed(BOUNDS.missed_cycles + more, BOUNDS.missed_cycles), STOPPED]
    rig.run()
    assert CommandAborted("MoveJoints") in rig.evrs
    assert rig.state.mode is Mode.DEPLOYED
    assert not rig.outputs.drive.power_on.any()
    rig.evrs.clear()
    rig.run(MoveJoints(floats(START)))
    assert not found(rig, Fault)


def test_cycles_missed_at_rest_are_reported_and_stop_nothing():
    rig = Rig(CONFIG, start_rad=START)
    rig.evrs.clear()
    skip(rig, 20)
    assert rig.evrs == [CyclesMissed(20, BOUNDS.missed_cycles), STOPPED]
    assert rig.state.mode is Mode.DEPLOYED


@pytest.mark.parametrize("first", [0, 1, 12345, -7])
def test_the_count_of_cycles_may_begin_anywhere(first):
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    rig.cycles = first
    rig.cycle()
    rig.cycle()
    assert not found(rig, CyclesSkipped | Fault)


@pytest.mark.parametrize("back", [0, 1, 50])
def test_a_count_of_cycles_that_repeats_or_goes_back_stops_the_move_which_may_be_commanded_again(back):
    rig = moving()
    last = rig.cycles
    rig.cycles -= back + 1
    rig.cycle()
    assert rig.evrs == [CycleCountWrong(last - back, last), STOPPED]
    rig.run()
    assert CommandAborted("MoveJoints") in rig.evrs
    assert rig.state.mode is Mode.DEPLOYED
    rig.evrs.clear()
    rig.run(MoveJoints(floats(START)))
    assert not found(rig, Fault)


@pytest.mark.parametrize("joint", Joint)
def test_cycles_are_counted_while_readings_are_bad(joint):
    rig = moving()
    for _ in range(10):
        rig.cycle(current_A=np.where(np.arange(5) == joint, np.nan, 0.0))
    rig.cycle()
    assert not found(rig, CyclesSkipped | CyclesMissed)
