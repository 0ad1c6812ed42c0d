"""What recording costs the closed loop: cycles with and without a log, in turns, in one run.

A cycle is timed as `marsarm run` goes through it: flight software, plant, judge, and with a log the truth and
the recorder. Stretches with and without take turns, so that a machine that gets slower does so for both. Each
stretch with a log has a recorder of its own, so that none runs beside the others. The end of a log, with all
that is left to write, comes once in a run, and counts once. Beside each pair of stretches the bare physics is
timed: what truth and recorder take of a cycle is told in steps of it, whatever the machine.

Example: python -m validation.recording
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.telemetry.recorder import Recorder
from ground.telemetry.ros_messages import SAMPLE_CYCLES
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.file import load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup
from validation.closed_loop import bare_step_s, nominal_reference, time_calls

SCENARIO = "contact-science"
STRETCH = 1000
"""Cycles between two turns."""
FIRST = 500
"""Cycles of warming up."""


MOST_COST = 0.10
"""Of the rate without a log."""
MOST_LATER_MS = 1.0
"""The 99.9th percentile of a cycle."""
MOST_BARE_STEPS = 0.65
"""Of truth and recorder in a cycle."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Times of cycles, one after the other."""

    cycles_us: NDArray[np.float64]
    """Shape (STRETCH,)."""
    writes_us: NDArray[np.float64]
    """Of the recorder, as much of each cycle; none if there is no log."""
    end_us: float = 0.0
    """Of the log, if there is one."""


def recording() -> dict[str, Any]:
    """Ratio of the rates, times of a cycle in microseconds, and whether both are in bounds."""
    with TemporaryDirectory() as folder:
        turns = list(_in_turns(Path(folder) / "run.mcap"))
    pairs = [(without, recorded) for without, recorded, _ in turns]
    alone, beside = (np.concatenate([one.cycles_us for one in turn]) for turn in zip(*pairs, strict=True))
    longer = median(float(recorded.cycles_us.sum() / without.cycles_us.sum()) for without, recorded in pairs)
    end_us = median(recorded.end_us for _, recorded in pairs)
    run_us = float(alone.mean()) * (len(alone) + len(beside))
    return {
        "cycles": len(alone) + len(beside),
        "median_us": {"without": float(np.median(alone)), "with": float(np.median(beside))},
        "end_ms": end_us / 1e3,
        **judge_cost(
            1 / (longer + end_us / run_us),
            float(np.percentile(alone, 99.9)),
            float(np.percentile(beside, 99.9)),
            median(bare_steps for _, _, bare_steps in turns),
        ),
        "load_average": os.getloadavg()[0],
    }


def judge_cost(rate_ratio: float, alone_us: float, beside_us: float, bare_steps: float) -> dict[str, Any]:
    """Judge the ratio of the rates, 99.9th percentiles of a cycle, and what truth and recorder take of it."""
    later_ms = (beside_us - alone_us) / 1e3
    return {
        "rate_with_by_without": rate_ratio,
        "p99.9_us": {"without": alone_us, "with": beside_us},
        "p99.9_later_ms": later_ms,
        "truth_and_recorder_bare_steps": bare_steps,
        "bounds": {
            "rate_with_by_without": 1 - MOST_COST,
            "p99.9_later_ms": MOST_LATER_MS,
            "truth_and_recorder_bare_steps": MOST_BARE_STEPS,
        },
        "in_bounds": rate_ratio >= 1 - MOST_COST
        and later_ms <= MOST_LATER_MS
        and bare_steps <= MOST_BARE_STEPS,
    }


def _in_turns(path: Path) -> Iterator[tuple[Stretch, Stretch, float]]:
    """A stretch without a log, one with a log, and bare steps that truth and recorder take of a cycle of it.

    Of the means from one sample to the next it is the median: the machine may give time to others.
    """
    arm, scenario = arm_named("nominal"), load_scenario(SCENARIO)
    loop = ClosedLoop(scenario_setup(scenario, arm, nominal_reference(), 0))
    truth_s = list[float]()
    loop.plant.truth = time_calls(loop.plant.truth, truth_s)  # type: ignore[method-assign]
    cycles = iter(ScenarioRun(loop, scenario))
    list(islice(cycles, FIRST))
    while True:
        loop.with_truth = False
        without = _stretch(cycles, None)
        loop.with_truth = True
        truth_s.clear()
        recorded = _stretch(cycles, Recorder(path, {}, loop.config))
        if len(recorded.cycles_us) < STRETCH:
            return
        spent_s = np.array(truth_s[:STRETCH]) + 1e-6 * recorded.writes_us
        yield (
            without,
            recorded,
            float(np.median(spent_s.reshape(-1, SAMPLE_CYCLES).mean(axis=1))) / bare_step_s(),
        )


def _stretch(cycles: Iterator[CycleRecord], recorder: Recorder | None) -> Stretch:
    times_s, write_s = [time.perf_counter()], list[float]()
    write = None if recorder is None else time_calls(recorder.write, write_s)
    for record in islice(cycles, STRETCH):
        if write is not None:
            write(record)
        times_s.append(time.perf_counter())
    ended_s = time.perf_counter()
    if recorder is not None:
        recorder.close()
    end_us = 1e6 * (time.perf_counter() - ended_s)
    return Stretch(1e6 * np.diff(times_s), 1e6 * np.array(write_s), end_us)


def main() -> None:
    """Measure and print; exit status 1 if recording costs too much."""
    found = recording()
    print(json.dumps(found, indent=2))
    sys.exit(0 if found["in_bounds"] else 1)


if __name__ == "__main__":
    main()
