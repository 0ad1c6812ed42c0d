"""Scenarios in the closed loop: places are taught by the true pose of the tool, then the run is judged."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, CYCLE_S
from fsw.dictionary.commands import MoveJoints, MoveTool
from fsw.dictionary.evrs import CommandCompleted, CommandRefused, Evr
from fsw.dictionary.params import TeachPoint
from fsw.dictionary.types import AUTO, Joints5, joints5, vector3
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.transforms import Array
from fsw.messages import ToolChannels
from sim.arms import BuiltArm, effects_of_run
from sim.effects.environment import NothingToTouch, default_ambient
from sim.frames import p_R_from_N
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.scenario.data import Scenario, TaughtPoint
from sim.scenario.judge import (
    CheckResult,
    Ending,
    Trace,
    evaluate_checks,
    needs_snapshot,
    note_snapshot,
    take_snapshot,
)
from sim.sequence import Outcome, SequenceRun, run_sequence
from sim.setting import World

TYPICAL_COMMAND_S: Final = 200.0
"""Duration of a typical command, for the progress: an arm unstows in 300 s, and docks in 60 s."""
NO_MOTION: Joints5 = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ScenarioResult:
    """Outcome of a scenario."""

    outcome: Outcome
    command: int
    """Number of the last command that began."""
    duration_s: float
    checks: tuple[CheckResult, ...]
    evrs: tuple[tuple[float, Evr], ...]
    """Time [s] and event."""

    @property
    def passed(self) -> bool:
        """Return whether every check passed; a run that was stopped or not checked did not."""
        complete = self.outcome is not Outcome.STOPPED and bool(self.checks)
        return complete and all(check.passed for check in self.checks)


def scenario_setup(scenario: Scenario, arm: BuiltArm, reference: Reference, seed: int) -> Setup:
    """Make the setup of a scenario for an arm that has its effects and its taught places."""
    poses = arm.params.poses
    start = poses.stowed_rad if scenario.start == "stowed" else poses.ready_rad
    timed = (injection.fault for injection in scenario.faults if injection.during is None)
    effects = (
        *default_ambient(arm.effects, scenario.temperature_C),
        *timed,
        *effects_of_run(scenario.effects),
    )
    return Setup(arm, scenario.world, start, seed, reference, effects)


class ScenarioRun(SequenceRun):
    """Scenario in a closed loop; `result` is complete after the last cycle."""

    def __init__(self, loop: ClosedLoop, scenario: Scenario):
        super().__init__(loop, scenario.commands)
        self._scenario = scenario
        self._trace = Trace()
        self._braked = self._refuses = False
        self._due_s = [fault.fault.at_s for fault in scenario.faults if fault.during is None]
        self.command = 0
        """Number of the present command, from 1."""
        self._begun_s = 0.0

    def __iter__(self) -> Iterator[CycleRecord]:
        """Yield every cycle; after a fault, run one cycle more with a command to move."""
        yield from super().__iter__()
        self._braked = self.loop.braked
        if self.outcome is Outcome.FAULTED:
            record = self.loop.cycle((MoveJoints(NO_MOTION, relative=True),))
            self._refuses = any(isinstance(evr, CommandRefused) for evr in record.outputs.evrs)
            yield record

    def guess_share(self, time_s: float) -> float:
        """Guess the share of all commands that is done, with a fraction of the present one.

        Nobody knows how long a command will last. The fraction is 1/2 after the mean duration of the commands
        before it, and approaches 1.
        """
        done = max(self.command - 1, 0)
        mean_s = self._begun_s / done if done else TYPICAL_COMMAND_S
        within_s = time_s - self._begun_s
        fraction = within_s / (within_s + max(mean_s, CYCLE_S))
        return (done + fraction) / max(len(self._scenario.commands), 1)

    def note(self, record: CycleRecord) -> None:
        """Begin a command with its faults, and keep what checks need of a cycle."""
        if record.commands:
            self.command += 1
            self._begun_s = record.tick / CYCLE_HZ
            self._inject()
        if needs_snapshot(self._scenario, record, self.command):
            note_snapshot(self._scenario, self._trace, take_snapshot(self.loop, record, self.command))

    @property
    def _begun_faults(self) -> int:
        """Count the faults of the scenario that have begun."""
        return sum(due_s <= self.loop.plant.data.time for due_s in self._due_s)

    def _inject(self) -> None:
        """Inject the faults of the command that has just begun."""
        for injection in self._scenario.faults:
            if injection.during == self.command:
                begun_s = self.loop.plant.data.time - CYCLE_S
                fault = replace(injection.fault, at_s=begun_s + injection.fault.at_s)
                self.loop.avionics.inject(fault)
                self._due_s.append(fault.at_s)

    def result(self) -> ScenarioResult:
        """Return the result; valid after the last cycle."""
        plant, state = self.loop.plant, self.loop.state
        ending = Ending(
            outcome=self.outcome,
            mode=state.mode,
            output_rad=plant.output_rad(),
            braked=self._braked,
            refuses=self._refuses,
            pending_faults=len(self._scenario.faults) - self._begun_faults,
            evrs=tuple(self.evrs),
        )
        stowed = np.array(self.loop.config.params.poses.stowed_rad)
        return ScenarioResult(
            outcome=self.outcome,
            command=self.command,
            duration_s=plant.data.time,
            checks=evaluate_checks(self._scenario, stowed, self._trace, ending),
            evrs=ending.evrs,
        )


TEACH_PASSES: Final = 3
"""Number of moves to the front of a place, each corrected by the true error of the last."""
SURVEY_DISTANCE_M: Final = 0.05
"""Distance in front of a place at which it is measured, clear of objects."""
TEACH_OFFSET_RAD: Final = 0.01
"""Distance of every joint from the place at the start."""
REST_S: Final = 1.0


class NotTaught(RuntimeError):
    """Place that the arm could not be taught."""


def teach(
    arm: BuiltArm, reference: Reference, points: tuple[TaughtPoint, ...], world: World, seed: int = 0
) -> BuiltArm:
    """Return the arm with these places among its parameters; NotTaught if a move is not completed."""
    found = tuple(_teach_point(arm, reference, point, world, seed) for point in points)
    names = {point.name for point in found}
    kept = tuple(point for point in arm.params.teach if point.name not in names)
    return replace(arm, params=replace(arm.params, teach=(*kept, *found)))


def _teach_point(
    arm: BuiltArm, reference: Reference, point: TaughtPoint, world: World, seed: int
) -> TeachPoint:
    axis = np.array(point.approach_N) / np.linalg.norm(point.approach_N)
    wanted = p_R_from_N(np.array(point.p_N_m)) - SURVEY_DISTANCE_M * axis
    start = _pose_near(arm, point, wanted, axis, world)
    level = replace(world, surface=None)
    tool = arm.params.tool_names.index(point.tool)
    loop = ClosedLoop(Setup(arm, level, joints5(start), seed, reference, (NothingToTouch(),)))
    aim, towards = wanted, axis
    for _ in range(TEACH_PASSES):
        believed = _move_tool_to(loop, point, aim, towards)
        truth = loop.plant.truth()
        error_m = wanted - truth.p_RoTo_R_m[tool]
        axis_error = axis - truth.R_RT[tool][:, 0]
        aim, towards = aim + error_m, towards + axis_error
    approach = believed.R_RT[:, 0] + axis_error
    return TeachPoint(
        name=point.name,
        tool=point.tool,
        p_RoTo_R_m=vector3(believed.p_RoTo_R_m + error_m + SURVEY_DISTANCE_M * approach),
        approach_R=vector3(approach),
        branch=point.branch,
    )


def _pose_near(arm: BuiltArm, point: TaughtPoint, p_R_m: Array, axis: Array, world: World) -> Array:
    """Return a pose beside the place, on its branch; of several the nearest to the ready pose."""
    ready = np.array(arm.params.poses.ready_rad)
    solutions = inverse_kinematics(
        build_arm(arm.params), point.tool, p_R_m, axis, world.gravity_N_m_s2, ready
    )
    poses = [
        solutions.output_rad[:, slot]
        for slot in np.flatnonzero(solutions.verdict == BranchVerdict.VALID)
        if point.branch in (AUTO, BRANCHES[slot % len(BRANCHES)])
    ]
    if not poses:
        raise NotTaught(f"{arm.name}: {point.name} is out of reach of the {point.tool}")
    nearest = min(poses, key=lambda pose: float(np.abs(pose - ready).max()))
    return np.asarray(nearest + TEACH_OFFSET_RAD * np.sign(ready - nearest))


def _move_tool_to(loop: ClosedLoop, point: TaughtPoint, p_R_m: Array, axis: Array) -> ToolChannels:
    """Move the tool and return its estimated pose at rest."""
    command = MoveTool(point.tool, vector3(p_R_m), vector3(axis), branch=point.branch)
    evrs = [evr for record in run_sequence(loop, (command,)) for evr in record.outputs.evrs]
    if loop.failure is not None:
        raise loop.failure
    if CommandCompleted("MoveTool") not in evrs:
        raise NotTaught(f"{point.name}: {evrs[-1].message}")
    seen = [loop.cycle().outputs.tool for _ in range(round(REST_S * CYCLE_HZ))]
    return [tool for tool in seen if tool is not None][-1]
