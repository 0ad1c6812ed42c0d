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
import sys
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
from ground.telemetry.recover import recover
from sim.loop import ClosedLoop
from sim.placement import PlacementRun

CYCLES = 4000
COUNTED = ("open", "wrong")
"""Kills that met a log before its end; the others say nothing about it."""
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
    """Whether a log holds messages that the whole one begins with, bit for bit, and nothing else."""
    packets = all(
        rows.tobytes() == whole[topic][: len(rows)].tobytes() for topic, rows in log.packets.items()
    )
    times = all(np.array_equal(ns, whole.time_ns[topic][: len(ns)]) for topic, ns in log.time_ns.items())
    evrs, commands = whole.evrs[: len(log.evrs)], whole.commands[: len(log.commands)]
    return packets and times and log.evrs == evrs and log.commands == commands


def recovers(path: Path, log: Log) -> bool:
    """Whether recovery saves just what a log holds."""
    good = path.with_name("good.mcap")
    recover(path, good, lambda *_: None)
    saved = read_log(good)
    counts = {topic: len(ns) for topic, ns in log.time_ns.items()}
    return is_start_of(saved, log) and counts == {topic: len(ns) for topic, ns in saved.time_ns.items()}


def lost_s(stamps_s: Any, kept: int, killed_s: float) -> float:
    """Wall time from the last cycle that was kept to the kill; none where no later one was recorded."""
    recorded = np.flatnonzero(stamps_s)
    if recorded.size <= kept:
        return 0.0
    return float(killed_s - stamps_s[max(kept - 1, 0)])


def one_kill(loop: ClosedLoop, path: Path, stamps_s: Any, at_s: float, whole: Log) -> tuple[str, float]:
    """What became of a log whose run was killed, and how much of the run's wall time it lacks [s]."""
    stamps_s[:] = 0.0
    path.unlink(missing_ok=True)
    child = start(loop, path, stamps_s)
    time.sleep(at_s)
    killed_s = time.monotonic()
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:  # between the fork and its group
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    try:
        log = read_log(path)
    except LogNotReadable:
        return "not begun", lost_s(stamps_s, 0, killed_s)
    loss_s = lost_s(stamps_s, len(log.packets.get("/joint", ())), killed_s)
    if not is_start_of(log, whole) or log.header != whole.header or not recovers(path, log):
        return "wrong", loss_s
    return "open" if log.truncated else "closed", loss_s


def timed(loop: ClosedLoop, path: Path, stamps_s: Any) -> float:
    """How long a run takes that nobody kills [s]."""
    begun_s = time.monotonic()
    os.waitpid(start(loop, path, stamps_s), 0)
    return time.monotonic() - begun_s


def kills(number: int, seed: int) -> Iterator[tuple[str, float]]:
    """Outcome and loss of each kill, until so many met an open log."""
    random = np.random.default_rng(seed)
    shared = mmap.mmap(-1, 8 * CYCLES)
    stamps_s = np.frombuffer(shared, np.float64)
    loop = closed_loop_of_a_placement(with_truth=True)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        length_s = min(timed(loop, path, stamps_s) for _ in range(3))
        whole = read_log(path)
        met = 0
        while met < number:
            outcome, loss_s = one_kill(loop, path, stamps_s, random.uniform(0.0, length_s), whole)
            met += outcome in COUNTED
            yield outcome, loss_s


def killed(number: int, seed: int) -> dict[str, Any]:
    """Counts of outcomes, and what was lost when the log was open, in milliseconds."""
    found = list(kills(number, seed))
    outcomes = [outcome for outcome, _ in found]
    lost_ms = 1e3 * np.array([loss_s for outcome, loss_s in found if outcome in COUNTED])
    return {
        "kills": number,
        "outcomes": {name: outcomes.count(name) for name in ("open", "closed", "not begun", "wrong")},
        "lost_ms": {
            "median": float(np.median(lost_ms)),
            "p99": float(np.percentile(lost_ms, 99)),
            "max": float(lost_ms.max()),
        },
        "beyond_bound": sum(loss_s > BOUND_S for _, loss_s in found),
        "bound_ms": 1e3 * BOUND_S,
        "load_average": os.getloadavg()[0],
    }


def main() -> None:
    """Kill and print."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.killed", description=__doc__)
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.add_argument("--kills", type=int, default=200, help="how many of open logs (default 200)")
    options.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    asked = options.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside the idle threads of a library
    found = killed(asked.kills, asked.seed)
    print(json.dumps(found, indent=2))
    sys.exit(1 if found["outcomes"]["wrong"] or found["beyond_bound"] else 0)


if __name__ == "__main__":
    main()
