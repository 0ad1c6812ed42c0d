"""Kill -9 of the whole process group at random moments of a recorded run: what is lost, and is the rest true.

Each run is a fork of this process, in a group of its own. It notes in shared memory when each of its cycles
was recorded, so that the loss is seen from outside; the same run, unkilled, says what a log ought to hold.

Example: python -m benchmarks.killed --kills 200
"""

import argparse
import json
import mmap
import os
import signal
import time
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.closed_loop import TARGET, closed_loop_of_a_placement
from ground.telemetry.errors import LogNotReadable
from ground.telemetry.read import Log, read_log
from ground.telemetry.record import Recorder
from sim.loop import ClosedLoop
from sim.placement import PlacementRun

CYCLES = 4000
LONGEST_S = 2.5
"""The last moment to kill at, counted from the fork: some runs have closed their logs by then."""
BOUND_S = 0.020


def record_run(loop: ClosedLoop, path: Path, stamps_s: Any) -> None:
    """Record the beginning of a placement; note when each cycle was."""
    with Recorder(path, {"seed": "0"}, loop.config) as recorder:
        for number, record in enumerate(islice(PlacementRun(loop, TARGET), CYCLES)):
            recorder.write(record)
            stamps_s[number] = time.monotonic()


def start(loop: ClosedLoop, path: Path, stamps_s: Any) -> int:
    """Record in a process group of its own; its number."""
    child = os.fork()
    if child:
        return child
    os.setsid()
    record_run(loop, path, stamps_s)
    os._exit(0)


def is_start_of(log: Log, whole: Log) -> bool:
    """Whether a log holds what the whole one begins with, bit for bit, and nothing else."""
    packets = all(
        rows.tobytes() == whole[topic][: len(rows)].tobytes() for topic, rows in log.packets.items()
    )
    times = all(np.array_equal(ns, whole.time_ns[topic][: len(ns)]) for topic, ns in log.time_ns.items())
    evrs, commands = whole.evrs[: len(log.evrs)], whole.commands[: len(log.commands)]
    return packets and times and log.evrs == evrs and log.commands == commands and log.header == whole.header


def one_kill(loop: ClosedLoop, path: Path, stamps_s: Any, at_s: float, whole: Log) -> tuple[str, float]:
    """What became of a log whose run was killed, and how much of the run's wall time it lacks [s]."""
    stamps_s[:] = 0.0
    path.unlink(missing_ok=True)
    child = start(loop, path, stamps_s)
    time.sleep(at_s)
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:  # between the fork and its group
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    run = np.flatnonzero(stamps_s)
    try:
        log = read_log(path)
    except LogNotReadable:
        return "not begun", 0.0 if run.size == 0 else float(stamps_s[run[-1]] - stamps_s[0])
    kept = len(log.packets.get("/joint", ()))
    last = max(run.size, kept) - 1
    lost_s = 0.0 if kept > last else float(stamps_s[run[-1]] - stamps_s[max(kept - 1, 0)])
    if not is_start_of(log, whole):
        return "wrong", lost_s
    return "cut short" if log.truncated else "closed", lost_s


def kills(number: int, seed: int) -> Iterator[tuple[str, float]]:
    """Outcome and loss of each of so many kills."""
    random = np.random.default_rng(seed)
    shared = mmap.mmap(-1, 8 * CYCLES)
    stamps_s = np.frombuffer(shared, np.float64)
    loop = closed_loop_of_a_placement(with_truth=True)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        os.waitpid(start(loop, path, stamps_s), 0)
        whole = read_log(path)
        for at_s in random.uniform(0.0, LONGEST_S, number):
            yield one_kill(loop, path, stamps_s, at_s, whole)


def killed(number: int, seed: int) -> dict[str, Any]:
    """Counts of outcomes, and the loss in milliseconds."""
    outcomes, losses_s = zip(*kills(number, seed), strict=True)
    lost_ms = 1e3 * np.array(losses_s)
    return {
        "kills": number,
        "outcomes": {name: outcomes.count(name) for name in ("closed", "cut short", "not begun", "wrong")},
        "lost_ms": {
            "median": float(np.median(lost_ms)),
            "p99": float(np.percentile(lost_ms, 99)),
            "max": float(lost_ms.max()),
        },
        "beyond_bound": int(np.sum(lost_ms > 1e3 * BOUND_S)),
        "bound_ms": 1e3 * BOUND_S,
        "load_average": os.getloadavg()[0],
    }


def main() -> None:
    """Kill and print."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.killed", description=__doc__)
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.add_argument("--kills", type=int, default=200, help="how many (default 200)")
    options.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    asked = options.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside the idle threads of a library
    print(json.dumps(killed(asked.kills, asked.seed), indent=2))


if __name__ == "__main__":
    main()
