"""A scenario in the closed loop, watched by a judge who knows the truth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Joints5, MoveJoints
from fsw.dictionary.evrs import CommandRefused, Evr
from fsw.estimate.reference import Reference
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.effects.environment import Ambient
from sim.judge import Measured, judged
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.scenario import Scenario
from sim.scenario_faults import timed
from sim.sequence import Outcome, run_sequence, watched
from sim.trace import Ending, Moment, Trace, moment

NO_STEP: Joints5 = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ScenarioResult:
    """What came of a scenario."""

    outcome: Outcome
    command: int
    """The number of the last command that began."""
    duration_s: float
    measured: tuple[Measured, ...]
    evrs: tuple[tuple[float, Evr], ...]
    """Time [s] and event."""

    @property
    def passed(self) -> bool:
        """Whether every check is; a run that was not judged has not passed."""
        return bool(self.measured) and all(measured.passed for measured in self.measured)


def setup_of(
    scenario: Scenario,
    arm: BuiltArm,
    reference: Reference,
    seed: int,
    faults: tuple[Effect, ...] = (),
) -> Setup:
    """How a scenario begins, with an arm whose joints are known and whose places are taught."""
    poses = arm.params.poses
    start = poses.stowed_rad if scenario.start == "stowed" else poses.ready_rad
    effects = (Ambient(scenario.temperature_C), *faults)
    return Setup(arm, scenario.world, start, seed, reference, effects)


def faults_of(scenario: Scenario, arm: BuiltArm, reference: Reference, seed: int) -> tuple[Effect, ...]:
    """The faults of a scenario, each with its time since the beginning.

    When a command begins is found by a rehearsal without faults: until the first of them comes, a run is the
    same to the last bit.
    """
    awaited = [fault.during for fault in scenario.faults if fault.during is not None]
    begins_s: dict[int, float] = {}
    if awaited:
        loop = ClosedLoop(setup_of(scenario, arm, reference, seed))
        for record in run_sequence(loop, scenario.commands):
            if record.commands:
                begins_s[len(begins_s) + 1] = record.tick / CYCLE_HZ
            if len(begins_s) >= max(awaited):
                break
    return tuple(
        timed(fault.effect, fault.at_s)
        if fault.during is None
        else timed(fault.effect, fault.at_s + begins_s.get(fault.during, np.inf))
        for fault in scenario.faults
    )


class ScenarioRun:
    """A scenario in a closed loop: iterate over its cycles, then ask for the result."""

    def __init__(self, loop: ClosedLoop, scenario: Scenario):
        self._loop = loop
        self._scenario = scenario
        self._moments: list[Moment] = []
        self._evrs: list[tuple[float, Evr]] = []
        self._outcome = Outcome.SOFTWARE_ERROR
        self._refuses = False
        self.command = 0
        """The number of the command under way, from 1."""

    def __iter__(self) -> Iterator[CycleRecord]:
        """Every cycle, as it happens; after a fault, one more in which a move is asked for."""
        sequence = run_sequence(self._loop, self._scenario.commands)
        self._outcome = yield from watched(sequence, self._note)
        if self._outcome is Outcome.FAULTED:
            record = self._loop.cycle((MoveJoints(NO_STEP, relative=True),))
            self._refuses = any(isinstance(evr, CommandRefused) for evr in record.outputs.evrs)
            yield record

    def _note(self, record: CycleRecord) -> None:
        self.command += len(record.commands)
        self._evrs += [(record.tick / CYCLE_HZ, evr) for evr in record.outputs.evrs]
        self._moments.append(moment(self._loop.plant, record, self.command))

    def result(self) -> ScenarioResult:
        """What came of it; after the last cycle."""
        plant, state = self._loop.plant, self._loop.state
        ending = Ending(
            outcome=self._outcome,
            mode=state.mode,
            output_rad=plant.output_rad(),
            braked=bool(plant.data.eq_active[plant.at.brake].all() and not state.drive.power_on.any()),
            refuses=self._refuses,
            evrs=tuple(self._evrs),
        )
        stowed = np.array(self._loop.config.params.poses.stowed_rad)
        trace = Trace(tuple(self._moments), ending)
        return ScenarioResult(
            outcome=self._outcome,
            command=self.command,
            duration_s=plant.data.time,
            measured=judged(self._scenario, stowed, trace),
            evrs=ending.evrs,
        )
