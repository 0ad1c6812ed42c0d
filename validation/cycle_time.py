"""Campaign of cycle times: no cycle of flight software takes much longer than a plain one.

Runs are scenarios, tool changes and placements, some of which are refused. Each is run three times from the
same start. As a run is deterministic, its cycles correspond, and of each cycle the least time counts: other
programs of the machine slow a cycle down, and never speed it up. Times are processor times of the thread
around `fsw.cycle.step` alone. Their unit is the median of the run, so that a bound holds on any machine.

The garbage collector is on, as it is by default. What was allocated before a run (the simulator and its
models) is kept from it, since an executive in flight would not have it.

Each placement also runs on a clock that does not wait: while a long cycle is computed, cycles are missed.
"""

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from math import ceil
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import sim.loop
from fsw.config import CYCLE_S
from fsw.cycle import step
from fsw.dictionary.commands import Retract, ToolChange
from fsw.dictionary.enums import Mode
from fsw.dictionary.faults import CyclesMissed
from fsw.dictionary.types import joints5
from fsw.estimate.reference import Reference
from sim.arms import BuiltArm, arm_named
from sim.frames import random_surface
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun, place_command, random_placement
from sim.record import CycleRecord
from sim.scenario.file import load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup, teach
from sim.sequence import Outcome, SequenceRun
from sim.setting import Surface, World
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document
from validation.scenarios import choose
from validation.tool_change import FIRST, SECOND, TILT_RAD

REPEATS: Final = 3
MOST_MEDIANS: Final = 60.0
"""Largest time of a cycle, in medians of its run."""
MOST_TO_MOTION_S: Final = 3.0
"""Largest Mars time from a command to its motion, in `SHARE_TO_MOTION` of the commands that move."""
SHARE_TO_MOTION: Final = 0.95
PLAIN_SHARE: Final = 0.05
"""Share of its period that a plain cycle takes on the assumed processor of flight.

The longest cycle allowed, of 60 plain ones, then takes three periods: two cycles are missed, of four that are
tolerated.
"""
LEVELS: Final = (10, 30, 60)
"""Numbers of medians above which cycles are counted."""
SLOWEST: Final = 5
"""Number of cycles of a run that are described."""

Times = NDArray[np.int64]


@contextmanager
def hooked_step(hook: Callable[..., Any]) -> Iterator[None]:
    """Let every closed loop call this function in place of `fsw.cycle.step`."""
    sim.loop.step = hook  # type: ignore[attr-defined]
    try:
        yield
    finally:
        sim.loop.step = step  # type: ignore[attr-defined]


@contextmanager
def timed_steps() -> Iterator[list[int]]:
    """Let every closed loop measure its cycles.

    Yields:
        A list, to which the nanoseconds of processor time of each call of `fsw.cycle.step` are appended.
    """
    times_ns: list[int] = []

    def timed(*arguments: Any) -> Any:
        began_ns = time.thread_time_ns()
        try:
            return step(*arguments)
        finally:
            times_ns.append(time.thread_time_ns() - began_ns)

    gc.collect()
    gc.freeze()
    try:
        with hooked_step(timed):
            yield times_ns
    finally:
        gc.unfreeze()


@dataclass(frozen=True, slots=True)
class CycleNote:
    """Cycle as two runs of the same start are compared, and as the report describes it."""

    mode: str
    command: str
    """Type of the last command."""
    since_command: int
    """Cycles since that command."""
    events: tuple[str, ...]
    is_moving: bool
    """Whether a set-point has a rate that is not zero."""
    setpoint_count: bytes

    def text(self) -> str:
        """Describe the cycle."""
        events = f": {', '.join(self.events)}" if self.events else ""
        return f"{self.mode}, {self.since_command} cycles after {self.command}{events}"


def note_cycles(records: Iterator[CycleRecord]) -> Iterator[CycleNote]:
    """Yield a note for each cycle."""
    command, since = "no command", 0
    for record in records:
        if record.commands:
            command, since = type(record.commands[-1]).__name__, 0
        drive = record.outputs.drive
        yield CycleNote(
            Mode(record.outputs.joint.mode).name,
            command,
            since,
            tuple(type(evr).__name__ for evr in record.outputs.evrs),
            bool(drive.setpoint_rate_rad_s.any()),
            drive.setpoint_count.tobytes(),
        )
        since += 1


@dataclass(frozen=True, slots=True)
class TimedRun:
    """Cycles of a run, with the least time of each."""

    notes: list[CycleNote]
    times_ns: Times
    """Least time of each cycle, (n,)."""
    outcome: Outcome


def time_run(start: ClosedLoop, begin: Callable[[ClosedLoop], SequenceRun]) -> TimedRun:
    """Run three times from the same start; RuntimeError if the runs differ."""
    first: list[CycleNote] = []
    least_ns: Times | None = None
    for _ in range(REPEATS):
        run = begin(start.fork())
        with timed_steps() as times_ns:
            notes = list(note_cycles(iter(run)))
        if run.loop.failure is not None:
            raise run.loop.failure
        if least_ns is None:
            first, least_ns = notes, np.array(times_ns)
        elif notes != first:
            differ = (k for k, (one, other) in enumerate(zip(first, notes, strict=False)) if one != other)
            raise RuntimeError(f"two runs of the same start differ, at first in cycle {next(differ, 'last')}")
        least_ns = np.minimum(least_ns, times_ns)
    assert least_ns is not None
    return TimedRun(first, least_ns, run.outcome)


def times_to_motion(notes: Sequence[CycleNote]) -> list[float]:
    """Compute the Mars time [s] from each command that moves to its first motion."""
    found = []
    is_waiting = False
    for note in notes:
        is_waiting = is_waiting or note.since_command == 0
        if is_waiting and note.is_moving:
            found.append(note.since_command * CYCLE_S)
            is_waiting = False
    return found


@dataclass(frozen=True, slots=True)
class TimeSummary:
    """Times of the cycles of one or several runs on an arm."""

    name: str
    cycles: int
    median_us: float
    p99_us: float
    p999_us: float
    largest_ms: float
    largest_medians: float
    above: dict[str, int]
    """Number of cycles above each of the levels, in medians."""
    slowest: tuple[str, ...]
    to_motion_s: tuple[float, ...]
    """Mars time from each command that moves to its motion."""
    outcomes: tuple[str, ...]
    failed_late: tuple[str, ...] = ()
    """Placements that were done on time and not on a clock that does not wait, with their warnings."""


def summarize_times(name: str, runs: Sequence[TimedRun], failed_late: Sequence[str] = ()) -> TimeSummary:
    """Summarize runs; their common median is that of a plain cycle."""
    times_ns = np.concatenate([run.times_ns for run in runs])
    notes = [note for run in runs for note in run.notes]
    median_ns = float(np.median(times_ns))
    medians = times_ns / median_ns
    slowest = np.argsort(-times_ns, kind="stable")[:SLOWEST]
    p99_us, p999_us = (1e-3 * float(q) for q in np.percentile(times_ns, (99.0, 99.9)))
    return TimeSummary(
        name=name,
        cycles=times_ns.size,
        median_us=1e-3 * median_ns,
        p99_us=p99_us,
        p999_us=p999_us,
        largest_ms=1e-6 * float(times_ns.max()),
        largest_medians=float(medians.max()),
        above={f"{level} medians": int((medians > level).sum()) for level in LEVELS},
        slowest=tuple(
            f"{medians[k]:.0f} medians, {1e-6 * times_ns[k]:.1f} ms: {notes[k].text()}" for k in slowest
        ),
        to_motion_s=tuple(time_s for run in runs for time_s in times_to_motion(run.notes)),
        outcomes=tuple(str(run.outcome) for run in runs),
        failed_late=tuple(failed_late),
    )


@cache
def reference_of(name: str) -> Reference:
    """Return the reference of an arm after its hardstop initialisation."""
    return initial_reference(arm_named(name))


def time_scenario(name: str, scenario_name: str) -> TimeSummary:
    """Time a scenario on an arm that was taught its places."""
    reference, scenario = reference_of(name), load_scenario(scenario_name)
    arm = teach(arm_named(name), reference, scenario.taught, scenario.world)
    loop = ClosedLoop(scenario_setup(scenario, arm, reference, 0))
    run = time_run(loop, partial(ScenarioRun, scenario=scenario))
    return summarize_times(f"{scenario_name}, {name}", [run])


def time_changes(name: str, seed: int, count: int) -> TimeSummary:
    """Time changes from the first tool to the second at random targets of an arm."""
    arm, runs = arm_named(name), []
    for draw in range(count):
        world, preview = random_placement(1000 * seed + draw, arm, FIRST, TILT_RAD)
        start = joints5(preview.standoff_rad)
        loop = ClosedLoop(Setup(arm, world, start, draw, reference_of(name)))
        place = place_command(preview.placement)
        commands = (place, ToolChange(SECOND), Retract(SECOND, place.standoff_m))
        runs.append(time_run(loop, partial(SequenceRun, commands=commands)))
    return summarize_times(f"tool changes, {name}", runs)


class LateLoop(ClosedLoop):
    """Closed loop on a clock that does not wait: a cycle that takes several periods misses the next ones.

    The motor controllers hold the last command meanwhile.
    """

    def __init__(self, setup: Setup, periods: Callable[[], float]):
        super().__init__(setup)
        self._periods = periods
        """Function that returns the time of the last call of flight software, in periods of a cycle."""

    def cycle(self, commands: tuple[Any, ...] = ()) -> CycleRecord:
        """Run one control cycle, then those that are missed while it is computed."""
        record = super().cycle(commands)
        for _ in range(ceil(self._periods()) - 1):
            self.avionics.sense()
            self._drive()
        return record


def random_target(seed: int, arm: BuiltArm) -> tuple[Setup, Placement]:
    """Draw a start and a placement of one of the touching tools in the workspace; it may be refused.

    A surface whose rock would touch the arm at the start is drawn again.
    """
    rng = np.random.default_rng([seed, 90])
    tools = tuple(dict.fromkeys(switch.tool for switch in arm.params.switches))
    while True:
        point, normal = random_surface(rng, arm.model.workspace)
        tilt, heading = rng.uniform(0.0, TILT_RAD), rng.uniform(-np.pi, np.pi)
        world = World(
            "mars", float(tilt * np.cos(heading)), float(tilt * np.sin(heading)), Surface(point, normal)
        )
        setup = Setup(arm, world, arm.params.poses.ready_rad, seed, reference_of(arm.name))
        if not ClosedLoop(setup).plant.data.ncon:
            return setup, Placement(tools[rng.integers(len(tools))], point, normal)


def time_placements(name: str, seeds: Sequence[int]) -> TimeSummary:
    """Time placements at random targets of an arm, and run each of them late.

    A placement that fails late is run again, and counts if it fails three times: another program of the
    machine may have slowed the first run down.
    """
    arm, runs, failed_late = arm_named(name), [], []
    for seed in seeds:
        setup, placement = random_target(seed, arm)
        runs.append(time_run(ClosedLoop(setup), partial(PlacementRun, placement=placement)))
        plain_ns = float(np.median(runs[-1].times_ns))
        late = [run_late(setup, placement, plain_ns)]
        while late[-1] is not None and len(late) < REPEATS:
            late.append(run_late(setup, placement, plain_ns))
        if runs[-1].outcome is Outcome.DONE and late[-1] is not None:
            failed_late.append(f"{placement.tool}, seed {seed}: {late[-1]}")
    return summarize_times(f"placements, {name}", runs, failed_late)


def run_late(setup: Setup, placement: Placement, plain_ns: float) -> str | None:
    """Place on a clock that does not wait, with measured times; return the warning of a failure, or None.

    Args:
        plain_ns: Time of a plain cycle, which takes `PLAIN_SHARE` of a period.
    """
    with timed_steps() as times_ns:
        run = PlacementRun(LateLoop(setup, lambda: PLAIN_SHARE * times_ns[-1] / plain_ns), placement)
        for _ in run:
            pass
    missed = next((evr.message for _, evr in run.evrs if isinstance(evr, CyclesMissed)), None)
    return missed if missed is not None or run.outcome is Outcome.DONE else str(run.outcome)


def campaign(
    context: Context,
    arms: int = 3,
    only: str = "",
    changes: int = 4,
    placements: int = 40,
) -> Document:
    """Time the scenarios, or only one, and tool changes on each arm, and placements shared by the arms."""
    if not 1 <= arms <= 3 or placements < arms:
        raise BadRequest("set arms: 1 to 3, with at least one placement each")
    names = ("nominal", f"calibrated:{context.seed + 1}", f"as-built:{context.seed + 1}")[:arms]
    jobs: list[tuple[Any, ...]] = [(time_scenario, name, one) for name in names for one in choose(only)]
    jobs += [(time_changes, name, context.seed + 1, changes) for name in names if changes]
    first = 1000 * context.seed
    seeds = [range(first + k, first + placements, arms) for k in range(arms)]
    jobs += [(time_placements, name, own) for name, own in zip(names, seeds, strict=True)]
    return report(context.each(_time, jobs, "runs"))


def _time(work: Callable[..., TimeSummary], *job: Any) -> TimeSummary:
    return work(*job)


def report(timed: Sequence[TimeSummary]) -> Document:
    """Report the times of all runs, and compare them with their bounds."""
    worst = max(timed, key=lambda one: one.largest_medians)
    to_motion_s = [time_s for one in timed for time_s in one.to_motion_s]
    outcomes = [outcome for one in timed if one.name.startswith("placements") for outcome in one.outcomes]
    failed_late = [text for one in timed for text in one.failed_late]
    motion_s = float(np.quantile(to_motion_s, SHARE_TO_MOTION))
    return {
        "largest_medians": worst.largest_medians,
        "largest_ms": max(one.largest_ms for one in timed),
        "largest_in": f"{worst.name}: {worst.slowest[0]}",
        "cycles": sum(one.cycles for one in timed),
        "above": {level: sum(one.above[level] for one in timed) for level in worst.above},
        "command_to_motion_s": {
            "commands": len(to_motion_s),
            "median": float(np.median(to_motion_s)),
            f"p{100 * SHARE_TO_MOTION:.0f}": motion_s,
            "max": max(to_motion_s),
        },
        "placements": {outcome: outcomes.count(outcome) for outcome in sorted(set(outcomes))},
        "late": {"failed": len(failed_late), "failures": failed_late},
        "runs": [_as_document(one) for one in timed],
        "bounds": {"largest_medians": MOST_MEDIANS, "command_to_motion_s": MOST_TO_MOTION_S, "late": 0},
        "in_bounds": worst.largest_medians <= MOST_MEDIANS
        and motion_s <= MOST_TO_MOTION_S
        and not failed_late,
    }


def _as_document(timed: TimeSummary) -> Document:
    return {name: getattr(timed, name) for name in TimeSummary.__slots__}
