"""Cost of recording in the closed loop: cycles with and without a log, alternating in one run.

A cycle is timed as in `marsarm run`: flight software, plant, checks, and with a log the truth and the
recorder. Stretches with and without a log alternate, so that a slower machine affects both. Each stretch with
a log has its own recorder, so that no other one runs during a stretch without. Closing a log happens once in
a run, and counts once. The bare physics is timed with each pair of stretches. Truth and recorder are measured
in its steps, which makes the result independent of the machine.
"""

import os
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

from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.ros_messages import SAMPLE_CYCLES
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.file import load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup
from validation.closed_loop import bare_step_s, nominal_reference, time_calls

SCENARIO = "contact-science"
STRETCH = 1000
"""Cycles in a stretch."""
FIRST = 500
"""Cycles of warm-up."""
MOST_COST = 0.10
"""Largest loss of rate by a log, as a share of the rate without one."""
MOST_LATER_MS = 1.0
"""Largest increase of the 99.9th percentile of a cycle."""
MOST_BARE_STEPS = 0.65
"""Largest time of truth and recorder in a cycle, in bare steps."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Times of consecutive cycles."""

    cycles_us: NDArray[np.float64]
    """Time of each cycle, shape (STRETCH,)."""
    writes_us: NDArray[np.float64]
    """Time of the recorder in each cycle, shape (STRETCH,); empty without a log."""
    end_us: float = 0.0
    """Time to close the log, if there is one."""


def recording() -> dict[str, Any]:
    """Measure the ratio of the rates, and times of a cycle in microseconds, and check their bounds."""
    with TemporaryDirectory() as folder:
        stretches = list(_alternate(Path(folder) / "run.mcap"))
    pairs = [(without, recorded) for without, recorded, _ in stretches]
    without_us, with_us = (
        np.concatenate([one.cycles_us for one in side]) for side in zip(*pairs, strict=True)
    )
    time_ratio = median(
        float(recorded.cycles_us.sum() / without.cycles_us.sum()) for without, recorded in pairs
    )
    end_us = median(recorded.end_us for _, recorded in pairs)
    run_us = float(without_us.mean()) * (len(without_us) + len(with_us))
    return {
        "cycles": len(without_us) + len(with_us),
        "median_us": {"without": float(np.median(without_us)), "with": float(np.median(with_us))},
        "end_ms": end_us / 1e3,
        **judge_cost(
            1 / (time_ratio + end_us / run_us),
            float(np.percentile(without_us, 99.9)),
            float(np.percentile(with_us, 99.9)),
            median(bare_steps for _, _, bare_steps in stretches),
        ),
        "load_average": os.getloadavg()[0],
    }


def judge_cost(rate_ratio: float, alone_us: float, beside_us: float, bare_steps: float) -> dict[str, Any]:
    """Compare the cost of recording with its bounds.

    Args:
        rate_ratio: Rate with a log over rate without.
        alone_us: 99.9th percentile of a cycle without a log.
        beside_us: 99.9th percentile of a cycle with a log.
        bare_steps: Time of truth and recorder in a cycle, in bare steps.
    """
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


def _alternate(path: Path) -> Iterator[tuple[Stretch, Stretch, float]]:
    """Run stretches without and with a log alternately.

    Yields:
        A stretch without a log, one with a log, and the bare steps that truth and recorder take in a cycle:
        the median of means between two samples, because other processes may interrupt.
    """
    arm, scenario = arm_named("nominal"), load_scenario(SCENARIO)
    loop = ClosedLoop(scenario_setup(scenario, arm, nominal_reference(), 0))
    truth_s = list[float]()
    loop.plant.truth = time_calls(loop.plant.truth, truth_s)  # type: ignore[method-assign]
    cycles = iter(ScenarioRun(loop, scenario))
    list(islice(cycles, FIRST))
    while True:
        loop.with_truth = False
        without = _time_stretch(cycles, None)
        loop.with_truth = True
        truth_s.clear()
        recorded = _time_stretch(cycles, Recorder(path, {}, loop.config))
        if len(recorded.cycles_us) < STRETCH:
            return
        spent_s = np.array(truth_s[:STRETCH]) + 1e-6 * recorded.writes_us
        yield (
            without,
            recorded,
            float(np.median(spent_s.reshape(-1, SAMPLE_CYCLES).mean(axis=1))) / bare_step_s(),
        )


def _time_stretch(cycles: Iterator[CycleRecord], recorder: Recorder | None) -> Stretch:
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
