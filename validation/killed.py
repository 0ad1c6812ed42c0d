"""Kill -9 of the whole process group at random moments of a recorded run: what is lost, and is the rest true.

Each run is a fork of this process, in a group of its own. It notes in shared memory when its log was open and
when each of its cycles was recorded; this process notes when it kills. So the loss is seen from outside: the
time from the last cycle in the log to the kill. The same run, unkilled, says how long it takes, so that the
moments fall into it, and what a log ought to hold. Only kills of open logs count. Each log is recovered too.

Example: python -m validation.killed --kills 200
"""

import argparse
import json
import mmap
import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ground.common.files import BadOutput
from ground.telemetry.errors import LogError
from ground.telemetry.read import Log, read_log
from ground.telemetry.recorder import Recorder
from ground.telemetry.recover import recover
from sim.loop import ClosedLoop
from sim.placement import PlacementRun
from validation.closed_loop import TARGET, placement_loop

CYCLES = 4000
BOUND_S = 0.020
STILL_S = 0.02
MOST_RUNS = 3
"""For each kill that is to count: some kills come before the log is open or after it is closed."""


@dataclass(frozen=True, slots=True)
class Kill:
    """What became of a log whose run was killed."""

    outcome: str
    """ "cut short", which alone counts; "not begun" or "closed" where no log was open; or what is wrong."""
    lost_s: float = 0.0
    """Of the wall time before the kill, what the log lacks."""
    lost_cycles: int = 0
    """That were run and are not in it: few where the machine gave the lost time to others."""


def record_run(loop: ClosedLoop, path: Path, stamps_s: Any) -> None:
    """Record the beginning of a placement; note when the log was open, and when each cycle was in it."""
    with Recorder(path, {"seed": "0"}, loop.config) as recorder:
        stamps_s[0] = time.monotonic()
        for number, record in enumerate(islice(PlacementRun(loop, TARGET), CYCLES), 1):
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


def is_recovered(path: Path, log: Log, whole: Log) -> bool:
    """Whether recovery makes a whole log of one cut short, with every message of its closed chunks."""
    try:
        recover(path, path.with_name("good.mcap"), lambda *_: None)
        good = read_log(path.with_name("good.mcap"))
    except (LogError, BadOutput):
        return False
    counts = [{topic: len(times) for topic, times in one.time_ns.items()} for one in (good, log)]
    return not good.truncated and is_start_of(good, whole) and counts[0] == counts[1]


def kill_at(child: int, at_s: float) -> float:
    """Kill the group of a process at a moment on the monotonic clock; the moment that it was."""
    time.sleep(max(0.0, at_s - time.monotonic()))
    killed_s = time.monotonic()
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:  # between the fork and its group
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return killed_s


def wait_until_still(path: Path) -> None:
    """Wait until nobody writes to a file: the writer is not a child of this process, to be waited for."""
    sizes = [-1, -2]
    while sizes[-1] != sizes[-2]:
        time.sleep(STILL_S)
        sizes.append(path.stat().st_size if path.exists() else 0)


def one_kill(loop: ClosedLoop, path: Path, stamps_s: Any, after_s: float, whole: Log) -> Kill:
    """Kill a run so long after its fork, and look at its log."""
    stamps_s[:] = 0.0
    path.unlink(missing_ok=True)
    forked_s = time.monotonic()
    killed_s = kill_at(start(loop, path, stamps_s), forked_s + after_s)
    wait_until_still(path)
    noted = int(np.count_nonzero(stamps_s))
    if noted == 0 and not path.exists():
        return Kill("not begun")
    try:
        log = read_log(path)
    except LogError as error:
        return Kill(f"wrong: {error}")
    if not is_start_of(log, whole):
        return Kill("wrong: not what the run was")
    if not log.truncated:
        return Kill("closed" if len(log["/joint"]) == CYCLES else "wrong: closed before the end of the run")
    if not is_recovered(path, log, whole):
        return Kill("wrong: not all of it was recovered")
    kept = len(log.packets.get("/joint", ()))
    if kept >= noted:
        return Kill("cut short")
    # Where this process had to wait between looking at the clock and killing, the run says how late it was.
    lost_s = max(killed_s, float(stamps_s[noted - 1])) - float(stamps_s[kept])
    return Kill("cut short", lost_s, noted - 1 - kept)


def kill_runs(number: int, seed: int) -> Iterator[Kill]:
    """Every kill until so many have hit an open log, or something is wrong with so many runs."""
    random = np.random.default_rng(seed)
    shared = mmap.mmap(-1, 8 * (1 + CYCLES))
    stamps_s = np.frombuffer(shared, np.float64)
    loop = placement_loop(with_truth=True)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        forked_s = time.monotonic()
        os.waitpid(start(loop, path, stamps_s), 0)
        lengths_s = [float(stamps_s[-1]) - forked_s]
        whole = read_log(path)
        counted = 0
        for part in random.uniform(0.0, 1.0, MOST_RUNS * number):
            forked_s = time.monotonic()
            kill = one_kill(loop, path, stamps_s, part * median(lengths_s), whole)
            yield kill
            if kill.outcome == "closed":  # how fast the machine is changes
                lengths_s.append(float(stamps_s[-1]) - forked_s)
            counted += kill.outcome not in ("closed", "not begun")
            print(f"{counted} of {number} kills", file=sys.stderr)
            if counted == number:
                return


def spread(losses: Sequence[float]) -> dict[str, float] | None:
    """What of the losses to print; None of none."""
    if not losses:
        return None
    return {
        "median": float(median(losses)),
        "p99": float(np.percentile(losses, 99)),
        "max": float(max(losses)),
    }


def measure_losses(number: int, seed: int) -> dict[str, Any]:
    """Counts of outcomes, what is wrong, and the losses of the logs that were cut short."""
    found = list(kill_runs(number, seed))
    outcomes = [kill.outcome for kill in found]
    short = [kill for kill in found if kill.outcome == "cut short"]
    lost_ms = [1e3 * kill.lost_s for kill in short]
    wrong = [outcome for outcome in outcomes if outcome.startswith("wrong")]
    named = {name: outcomes.count(name) for name in ("cut short", "closed", "not begun")}
    return {
        "runs": len(found),
        "kills": len(short) + len(wrong),
        "outcomes": {**named, "wrong": len(wrong)},
        "wrong": wrong,
        "lost_ms": spread(lost_ms),
        "lost_cycles": spread([kill.lost_cycles for kill in short]),
        "beyond_bound": sum(one > 1e3 * BOUND_S for one in lost_ms),
        "bound_ms": 1e3 * BOUND_S,
        "load_average": os.getloadavg()[0],
    }


def main() -> None:
    """Kill and print; exit status 1 if a log is wrong, one lost too much, or too few were open."""
    options = argparse.ArgumentParser(prog="python -m validation.killed", description=__doc__)
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.add_argument("--kills", type=int, default=200, help="how many of open logs (default 200)")
    options.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    asked = options.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside the idle threads of a library
    found = measure_losses(asked.kills, asked.seed)
    print(json.dumps(found, indent=2))
    sys.exit(1 if found["wrong"] or found["beyond_bound"] or found["kills"] < asked.kills else 0)


if __name__ == "__main__":
    main()
