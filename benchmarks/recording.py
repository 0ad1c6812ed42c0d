"""What recording costs the closed loop: cycles with and without a log, in turns, in one run.

A cycle is timed as `marsarm run` goes through it: flight software, plant, judge, and with a log the truth and
the recorder. Stretches with and without take turns, so that a machine that gets slower does so for both. Each
stretch with a log has a recorder of its own, so that none runs beside the others. The end of a log, with all
that is left to write, comes once in a run, and counts once.

Example: python -m benchmarks.recording
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

from benchmarks.closed_loop import reference
from ground.telemetry.record import Recorder
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.file import load
from sim.scenario.run import ScenarioRun, setup_of

SCENARIO = "contact-science"
STRETCH = 1000
"""Cycles between two turns."""
FIRST = 500
"""Cycles of warming up."""


MOST_COST = 0.10
"""Of the rate without a log."""
MOST_LATER_MS = 1.0
"""The 99.9th percentile of a cycle."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Times of cycles, one after the other."""

    cycles_us: NDArray[np.float64]
    """Shape (STRETCH,)."""
    end_us: float = 0.0
    """Of the log, if there is one."""


def recording() -> dict[str, Any]:
    """Ratio of the rates, times of a cycle in microseconds, and whether both are in bounds."""
    with TemporaryDirectory() as folder:
        pairs = list(_in_turns(Path(folder) / "run.mcap"))
    alone, beside = (np.concatenate([one.cycles_us for one in turn]) for turn in zip(*pairs, strict=True))
    longer = median(float(recorded.cycles_us.sum() / without.cycles_us.sum()) for without, recorded in pairs)
    end_us = median(recorded.end_us for _, recorded in pairs)
    run_us = float(alone.mean()) * (len(alone) + len(beside))
    return {
        "cycles": len(alone) + len(beside),
        "median_us": {"without": float(np.median(alone)), "with": float(np.median(beside))},
        "end_ms": end_us / 1e3,
        **judged(
            1 / (longer + end_us / run_us),
            float(np.percentile(alone, 99.9)),
            float(np.percentile(beside, 99.9)),
        ),
        "load_average": os.getloadavg()[0],
    }


def judged(rate_ratio: float, alone_us: float, beside_us: float) -> dict[str, Any]:
    """The ratio of the rates, the 99.9th percentiles of a cycle without and with a log, and the verdict."""
    later_ms = (beside_us - alone_us) / 1e3
    return {
        "rate_with_by_without": rate_ratio,
        "p99.9_us": {"without": alone_us, "with": beside_us},
        "p99.9_later_ms": later_ms,
        "bounds": {"rate_with_by_without": 1 - MOST_COST, "p99.9_later_ms": MOST_LATER_MS},
        "in_bounds": rate_ratio >= 1 - MOST_COST and later_ms <= MOST_LATER_MS,
    }


def _in_turns(path: Path) -> Iterator[tuple[Stretch, Stretch]]:
    """Every stretch without a log, and the one with a log after it."""
    arm, scenario = arm_named("nominal"), load(SCENARIO)
    loop = ClosedLoop(setup_of(scenario, arm, reference(), 0))
    cycles = iter(ScenarioRun(loop, scenario))
    list(islice(cycles, FIRST))
    while True:
        loop.with_truth = False
        without = _stretch(cycles, None)
        loop.with_truth = True
        recorded = _stretch(cycles, Recorder(path, {}, loop.config))
        if len(recorded.cycles_us) < STRETCH:
            return
        yield without, recorded


def _stretch(cycles: Iterator[CycleRecord], recorder: Recorder | None) -> Stretch:
    times_s = [time.perf_counter()]
    for record in islice(cycles, STRETCH):
        if recorder is not None:
            recorder.write(record)
        times_s.append(time.perf_counter())
    ended_s = time.perf_counter()
    if recorder is not None:
        recorder.close()
    return Stretch(1e6 * np.diff(times_s), 1e6 * (time.perf_counter() - ended_s))


def main() -> None:
    """Measure and print; exit status 1 if recording costs too much."""
    found = recording()
    print(json.dumps(found, indent=2))
    sys.exit(0 if found["in_bounds"] else 1)


if __name__ == "__main__":
    main()
