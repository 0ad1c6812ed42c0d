"""Cost of recording: processor time of the plant's truth and of the recorder in a cycle of `contact-science`.

Opening and closing the log count once in the run. So would other processes of the recorder, which has none.
The slowest writes are those that close a chunk.

Example: python -m validation.recording
"""

import json
import os
import sys
import time
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from marsarm.telemetry.recorder import Recorder
from sim.arms import arm_named
from sim.loop import ClosedLoop
from sim.scenario.file import load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup
from validation.closed_loop import nominal_reference, time_calls

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
        recorder = Recorder(Path(folder) / "run.mcap", {}, loop.config)
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
    return {
        "cycles": len(write_s),
        "truth_us": truth_us,
        "recorder_us": write_us + ends_us,
        **judge_cost(truth_us + write_us + ends_us, 1e3 * float(np.percentile(write_s, 99.9))),
        "load_average": os.getloadavg()[0],
    }


def _median_us(times_s: list[float]) -> float:
    """Return the median over stretches of their mean: other programs slow some stretches down."""
    whole = len(times_s) // STRETCH * STRETCH
    return 1e6 * float(np.median(np.reshape(times_s[:whole], (-1, STRETCH)).mean(axis=1)))


def _children_s() -> float:
    """Return the processor time of the child processes that have ended."""
    return os.times().children_user + os.times().children_system


def judge_cost(both_us: float, write_ms: float) -> dict[str, Any]:
    """Compare the cost of recording with its bounds.

    Args:
        both_us: Processor time of truth and recorder in a cycle.
        write_ms: 99.9th percentile of the processor time of a write.
    """
    return {
        "truth_and_recorder_us": both_us,
        "write_p99.9_ms": write_ms,
        "bounds": {"truth_and_recorder_us": MOST_US, "write_p99.9_ms": MOST_WRITE_MS},
        "in_bounds": both_us <= MOST_US and write_ms <= MOST_WRITE_MS,
    }


def main() -> None:
    """Print the result as JSON; exit with 1 if recording costs too much."""
    found = recording()
    print(json.dumps(found, indent=2))
    sys.exit(0 if found["in_bounds"] else 1)


if __name__ == "__main__":
    main()
