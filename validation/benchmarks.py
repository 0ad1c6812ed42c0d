"""Measure speeds, and the memory of a run without a log.

Cycles: processor time of flight software in each cycle of the six scenarios, run once. What is told of the
longest cycle holds other programs too; the campaign `cycle-time` takes the least of three runs.

Recording: processor time of the plant's truth and of the recorder in a cycle of `contact-science`. Opening
and closing the log count once in the run. So would other processes of the recorder, which has none. The
slowest writes are those that close a chunk.

Sample logs of any length repeat the beginning of a hardstop initialisation.
"""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import cycle, islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import CalibrateAll
from fsw.estimate.reference import Reference
from marsarm.accuracy.budget import run_budget
from marsarm.accuracy.request import BudgetRequest
from marsarm.runs.execution import FRAME_CYCLES
from marsarm.runs.request import RunRequest
from marsarm.runs.scenario import run_scenario
from marsarm.telemetry.format import CHUNK_CYCLES
from marsarm.telemetry.recorder import Recorder
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun
from sim.record import CycleRecord
from sim.scenario.file import built_in_scenarios, load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup, teach
from sim.setting import Surface, World
from validation.campaigns import Context, Document
from validation.cycle_time import Times, timed_steps

REPEATS = 5
TARGET = Placement("apxs", (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))


@cache
def nominal_reference() -> Reference:
    """Return the reference of the nominal arm after its hardstop initialisation."""
    return initial_reference(arm_named("nominal"))


def placement_loop() -> ClosedLoop:
    """Make a closed loop with the nominal arm in the ready pose in front of the target."""
    arm = arm_named("nominal")
    world = World(surface=Surface(TARGET.p_N_m, TARGET.normal_N))
    return ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, reference=nominal_reference()))


def _realtime_factor() -> float:
    """Measure simulated time over wall time of a placement in the closed loop."""
    loop = placement_loop()
    began = time.perf_counter()
    cycles = sum(1 for _ in PlacementRun(loop, TARGET))
    return cycles / CYCLE_HZ / (time.perf_counter() - began)


def time_calls(
    function: Callable[..., Any], times_s: list[float], clock: Callable[[], float] = time.perf_counter
) -> Callable[..., Any]:
    """Wrap a function so that the duration of each call, by a clock, is appended to `times_s`."""

    def run(*args: Any) -> Any:
        began = clock()
        result = function(*args)
        times_s.append(clock() - began)
        return result

    return run


def closed_loop() -> dict[str, Any]:
    """Measure the speed of the closed loop, and that of flight software in it."""
    with timed_steps() as times_ns:
        for _ in PlacementRun(placement_loop(), TARGET):
            pass
    fsw_us = 1e-3 * np.array(times_ns)
    return {
        "realtime_factor": median(_realtime_factor() for _ in range(REPEATS)),
        "fsw_step_us": {
            "median": float(np.median(fsw_us)),
            "p99": float(np.percentile(fsw_us, 99)),
            "max": float(fsw_us.max()),
        },
    }


EDGES_US: Final = 2.0 ** np.arange(4, 21)
"""Edges of the histogram of cycle times, a factor of two apart: from 16 us to a second."""
SIGNS_PER_DECADE: Final = 10
"""Signs by which a bar is longer for ten times as many cycles."""


def cycle_times() -> Document:
    """Measure the processor time of flight software in each cycle of the six scenarios."""
    reference, found = nominal_reference(), list[int]()
    for name in built_in_scenarios():
        scenario = load_scenario(name)
        arm = teach(arm_named("nominal"), reference, scenario.taught, scenario.world)
        loop = ClosedLoop(scenario_setup(scenario, arm, reference, 0))
        with timed_steps() as times_ns:
            for _ in ScenarioRun(loop, scenario):
                pass
        found += times_ns
    return describe_cycles(np.array(found))


def describe_cycles(times_ns: Times) -> Document:
    """Describe the times of cycles, (n,), with a histogram in numbers and in bars of text."""
    times_us = 1e-3 * times_ns
    median_us = float(np.median(times_us))
    counts, _ = np.histogram(np.clip(times_us, EDGES_US[0], EDGES_US[-1]), EDGES_US)
    filled = np.flatnonzero(counts)
    shown = range(filled[0], filled[-1] + 1)
    return {
        "count": times_us.size,
        "median_us": median_us,
        "p99_us": float(np.percentile(times_us, 99)),
        "largest_us": float(times_us.max()),
        "largest_over_median": float(times_us.max()) / median_us,
        "histogram": {
            "edges_us": EDGES_US[shown.start : shown.stop + 1].tolist(),
            "cycles": counts[shown.start : shown.stop].tolist(),
        },
        "bars": {f"{EDGES_US[k]:7.0f} to {EDGES_US[k + 1]:7.0f} us": _bar(int(counts[k])) for k in shown},
    }


def _bar(count: int) -> str:
    """Draw a number of cycles as a bar, which grows with its logarithm."""
    length = round(1 + SIGNS_PER_DECADE * np.log10(count)) if count else 0
    return f"{count:7d} {'#' * length}".rstrip()


SCENARIO: Final = "contact-science"
STRETCH: Final = 1024
"""Cycles in a stretch: whole chunks."""
FIRST: Final = 500
"""Cycles of warm-up."""
CYCLES: Final = 50_000
"""Cycles that are recorded, if the scenario has as many."""
MOST_US: Final = 65.0
"""Largest processor time of truth and recorder in a cycle, mean over a stretch."""
MOST_WRITE_MS: Final = 1.0
"""Largest processor time of the slowest write of 1,000."""


def recording() -> dict[str, Any]:
    """Measure processor times, all processes counted, and check their bounds."""
    arm, scenario = arm_named("nominal"), load_scenario(SCENARIO)
    loop = ClosedLoop(scenario_setup(scenario, arm, nominal_reference(), 0), with_truth=True)
    truth_s = list[float]()
    loop.plant.truth = time_calls(loop.plant.truth, truth_s, time.process_time)  # type: ignore[method-assign]
    cycles = iter(ScenarioRun(loop, scenario))
    list(islice(cycles, FIRST))
    write_s = list[float]()
    before, began_s = _children_s(), time.process_time()
    with TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "run.mcap", {}, loop.config.params)
        ends_s = time.process_time() - began_s
        write = time_calls(recorder.write, write_s, time.process_time)
        truth_s.clear()
        for record in islice(cycles, CYCLES):
            write(record)
        began_s = time.process_time()
        recorder.close()
        ends_s += time.process_time() - began_s
    ends_us = 1e6 * (ends_s + _children_s() - before) / len(write_s)
    truth_us, write_us = (_median_us(times_s) for times_s in (truth_s[: len(write_s)], write_s))
    both_us, write_ms = truth_us + write_us + ends_us, 1e3 * float(np.percentile(write_s, 99.9))
    return {
        "cycles": len(write_s),
        "truth_us": truth_us,
        "recorder_us": write_us + ends_us,
        "truth_and_recorder_us": both_us,
        "write_p99.9_ms": write_ms,
        "bounds": {"truth_and_recorder_us": MOST_US, "write_p99.9_ms": MOST_WRITE_MS},
        "in_bounds": both_us <= MOST_US and write_ms <= MOST_WRITE_MS,
        "load_average": os.getloadavg()[0],
    }


def _median_us(times_s: list[float]) -> float:
    """Return the median over stretches of their mean: other programs slow some stretches down."""
    whole = len(times_s) // STRETCH * STRETCH
    return 1e6 * float(np.median(np.reshape(times_s[:whole], (-1, STRETCH)).mean(axis=1)))


def _children_s() -> float:
    """Return the processor time of the child processes that have ended."""
    return os.times().children_user + os.times().children_system


PERIOD: Final = 8192
"""Cycles after which the recorded cycles repeat."""


@cache
def hardstop_cycles(cycles: int) -> tuple[CycleRecord, ...]:
    """Run the first cycles of a hardstop initialisation; the records contain the truth of the plant."""
    arm = arm_named("nominal")
    loop = ClosedLoop(Setup(arm, World(), arm.params.poses.ready_rad), with_truth=True)
    return tuple(loop.cycle((CalibrateAll(),) if tick == 0 else ()) for tick in range(cycles))


def record_log(path: Path, cycles: int, chunk_cycles: int = CHUNK_CYCLES) -> Path:
    """Write a complete log of this many cycles."""
    with Recorder(path, {"seed": "0", "arm": "nominal"}, chunk_cycles=chunk_cycles) as recorder:
        for tick, record in zip(range(cycles), cycle(hardstop_cycles(min(max(cycles, 1), PERIOD)))):
            recorder.write(replace(record, tick=tick))
    return path


FROM_CYCLE: Final = 2_000
BY_CYCLE: Final = 10_000
MOST_GROWTH_MB: Final = 20.0
"""Largest growth of the resident memory from `FROM_CYCLE` to the end of a run."""
BUDGET_LIMIT_S: Final = 3.0
BUDGET_RUNS: Final = 3


def campaign(context: Context) -> Document:
    """Measure everything."""
    results: Document = {
        "machine": {"python": platform.python_version(), "machine": platform.machine()},
        "closed_loop": closed_loop(),
        "cycles": cycle_times(),
        "recording": recording(),
        "budget": budget_speed(),
        "memory": memory(),
    }
    return {**results, "in_bounds": all(one.get("in_bounds", True) for one in results.values())}


def memory() -> Document:
    """Measure the resident memory by cycle, and compare its growth with the bound."""
    resident: list[tuple[str, float]] = []
    run_scenario(
        RunRequest("contact-science"), lambda _, __, activity: resident.append((activity, _resident_MB()))
    )
    begun = [activity for activity, _ in resident].index("teaching") + 1
    by_cycle = {n * FRAME_CYCLES: size_MB for n, (_, size_MB) in enumerate(resident[begun:])}
    later_MB = [size_MB for cycle, size_MB in by_cycle.items() if cycle >= FROM_CYCLE]
    growth_MB = max(later_MB) - later_MB[0]
    return {
        "resident_MB": {cycle: by_cycle[cycle] for cycle in list(by_cycle)[:: BY_CYCLE // FRAME_CYCLES]},
        "cycles": max(by_cycle),
        "growth_MB": growth_MB,
        "limit_MB": MOST_GROWTH_MB,
        "in_bounds": growth_MB <= MOST_GROWTH_MB,
    }


def _resident_MB() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def budget_speed() -> Document:
    """Measure the error budget; the shortest of some runs counts."""
    request, took_s = BudgetRequest(), []
    for _ in range(BUDGET_RUNS):
        began = time.perf_counter()
        report = run_budget(request, lambda *_: None)
        took_s.append(time.perf_counter() - began)
    return {
        "poses": request.poses,
        "sources": len(report.model.source),
        "cases": len(report.budgets),
        "seconds": min(took_s),
        "limit_s": BUDGET_LIMIT_S,
        "in_bounds": min(took_s) < BUDGET_LIMIT_S,
    }
