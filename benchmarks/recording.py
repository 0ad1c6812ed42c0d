"""What recording costs the closed loop: cycles with and without a log, in turns, in one run.

A cycle is timed as `marsarm run` goes through it: flight software, plant, judge, and with a log the truth and
the recorder. Stretches with and without take turns, so that a machine that gets slower does so for both.
"""

import time
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.closed_loop import reference
from ground.telemetry.record import Recorder
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.file import load
from sim.scenario.run import ScenarioRun, setup_of

SCENARIO = "contact-science"
STRETCH = 250
"""Cycles between two turns."""
FIRST = 500
"""Cycles of warming up."""


def recording() -> dict[str, Any]:
    """Ratio of the rates without and with, and the times of a cycle in microseconds."""
    with TemporaryDirectory() as folder:
        without, recorded = _in_turns(Path(folder) / "run.mcap")
    shortest = min(len(without), len(recorded))
    pairs = list(zip(without[:shortest], recorded[:shortest], strict=True))
    alone, beside = (np.concatenate(one) for one in zip(*pairs, strict=True))
    p999 = [float(np.percentile(one, 99.9)) for one in (alone, beside)]
    return {
        "cycles": len(alone) + len(beside),
        "rate_with_by_without": median(float(a.sum() / b.sum()) for a, b in pairs),
        "median_us": {"without": float(np.median(alone)), "with": float(np.median(beside))},
        "p99.9_us": {"without": p999[0], "with": p999[1]},
        "p99.9_later_ms": (p999[1] - p999[0]) / 1e3,
    }


def _in_turns(path: Path) -> tuple[list[Any], list[Any]]:
    """Microseconds of the cycles of every stretch, shape (STRETCH,) each: without a log and with."""
    arm, scenario = arm_named("nominal"), load(SCENARIO)
    loop = ClosedLoop(setup_of(scenario, arm, reference(), 0))
    cycles = iter(ScenarioRun(loop, scenario))
    stretches: tuple[list[Any], list[Any]] = ([], [])
    with Recorder(path, {}, loop.config) as recorder:
        list(islice(cycles, FIRST))
        while True:
            for turn in (0, 1):
                loop.with_truth = bool(turn)
                times_us = _stretch(cycles, recorder if turn else None)
                if len(times_us) < STRETCH:
                    return stretches
                stretches[turn].append(times_us)


def _stretch(cycles: Any, recorder: Recorder | None) -> Any:
    times_s = [time.perf_counter()]
    record: CycleRecord
    for record in islice(cycles, STRETCH):
        if recorder is not None:
            recorder.write(record)
        times_s.append(time.perf_counter())
    return 1e6 * np.diff(times_s)
