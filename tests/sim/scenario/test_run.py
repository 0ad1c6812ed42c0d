"""Scenarios in the closed loop: order of events and results."""

from dataclasses import replace

import pytest

from fsw.dictionary.commands import ClearFault, MoveJoint, Preload, Stop
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandAccepted, CommandRefused
from fsw.dictionary.faults import SensorNotFinite
from sim.arms import arm_named
from sim.effects.environment import PowerLoss
from sim.effects.faults import MissedCycles, SensorFault
from sim.loop import ClosedLoop
from sim.scenario.data import Done, Faulted, Injection, Recovered, Scenario
from sim.scenario.run import ScenarioResult, ScenarioRun, scenario_setup
from sim.sequence import Outcome
from sim.setting import World
from tests.sim import lab

NOMINAL = arm_named("nominal")
REFERENCE = lab.true_reference(NOMINAL)
A_LITTLE, BACK = MoveJoint(Joint.TURRET, 1.6), MoveJoint(Joint.TURRET, 1.5)
DONE = (Done(),)


def scenario(*commands, checks=DONE, faults=()) -> Scenario:
    return Scenario("test", "T", "S.", World(), commands, checks, "ready", faults=faults)


def run(made: Scenario) -> ScenarioResult:
    judged = ScenarioRun(ClosedLoop(scenario_setup(made, NOMINAL, REFERENCE, 1)), made)
    ticks = [record.tick for record in judged]
    assert ticks == list(range(len(ticks)))
    return judged.result()


def test_commands_follow_each_other_and_are_counted():
    result = run(scenario(A_LITTLE, BACK))
    assert (result.outcome, result.command, result.passed) == (Outcome.DONE, 2, True)
    accepted = [time_s for time_s, evr in result.evrs if evr == CommandAccepted("MoveJoint")]
    assert accepted[0] == 0.0
    assert accepted[1] > 3.0


def test_a_refusal_ends_the_scenario_and_its_command_is_told():
    result = run(scenario(A_LITTLE, Preload("drill", 100.0), BACK))
    assert (result.outcome, result.command, result.passed) == (Outcome.REFUSED, 2, False)
    assert isinstance(result.evrs[-1][1], CommandRefused)


def test_without_power_the_arm_is_braked_and_refuses():
    cut = Injection(PowerLoss(1.0), during=2)
    result = run(scenario(A_LITTLE, BACK, A_LITTLE, checks=(Faulted("FollowingErrorHigh"),), faults=(cut,)))
    assert (result.outcome, result.command) == (Outcome.FAULTED, 2)
    assert [measured.name for measured in result.checks] == [
        "FollowingErrorHigh",
        "braked",
        "refuses",
        "every fault came",
    ]
    assert all(measured.passed for measured in result.checks[1:]), result.evrs


def test_a_fault_during_a_command_comes_so_long_after_it_began():
    undisturbed = run(scenario(A_LITTLE, BACK))
    begins_s = [time_s for time_s, evr in undisturbed.evrs if evr == CommandAccepted("MoveJoint")][1]
    deaf = SensorFault(0.5, "current_A", "nan")
    result = run(scenario(A_LITTLE, BACK, faults=(Injection(deaf, during=2),)))
    found_s = next(time_s for time_s, evr in result.evrs if isinstance(evr, SensorNotFinite))
    assert found_s == pytest.approx(begins_s + 0.5, abs=1.5 / 64)


def test_a_fault_that_is_not_cleared_ends_the_scenario_before_the_next_command():
    cut = Injection(PowerLoss(0.5))
    result = run(scenario(A_LITTLE, Stop(), faults=(cut,)))
    assert (result.outcome, result.command) == (Outcome.FAULTED, 1)


def test_the_temperature_of_a_scenario_is_that_of_the_windings():
    cold = replace(scenario(A_LITTLE), temperature_C=-40.0)
    loop = ClosedLoop(scenario_setup(cold, NOMINAL, REFERENCE, 1))
    assert loop.avionics.sense().winding_C == pytest.approx(-40.0)


def test_a_scenario_without_a_measurement_has_not_passed():
    assert not ScenarioResult(Outcome.DONE, 0, 0.0, (), ()).passed


def test_a_command_that_a_fault_ended_was_not_carried_out_even_if_the_sequence_goes_on():
    cut = Injection(PowerLoss(0.5))
    checks = (Done(), Recovered("MotorStalled"))
    result = run(scenario(A_LITTLE, ClearFault(), Stop(), checks=checks, faults=(cut,)))
    done, came, went_on, every = result.checks
    assert not done.passed
    assert all(measured.passed for measured in (came, went_on, every)), result.checks


def test_after_a_fault_that_only_stops_there_is_nothing_to_clear_and_stop_goes_on():
    missed = Injection(MissedCycles(0.5, 20), during=1)
    ends = run(scenario(A_LITTLE, checks=(Faulted("CyclesMissed"),), faults=(missed,)))
    assert ends.outcome is Outcome.FAULTED
    assert ends.passed, ends.measured
    goes_on = run(scenario(A_LITTLE, Stop(), A_LITTLE, checks=(Recovered("CyclesMissed"),), faults=(missed,)))
    assert goes_on.passed, goes_on.measured


def test_a_fault_that_never_came_is_told():
    late = Injection(PowerLoss(1e4))
    result = run(scenario(A_LITTLE, faults=(late,)))
    assert [m.name for m in result.checks if not m.passed] == ["every fault came"]
