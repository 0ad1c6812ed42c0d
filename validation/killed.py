"""Campaign of killed runs: SIGKILL to the whole process group at random times, and a check of the log.

Each run is a fork of this process, in its own process group. It stores in shared memory when its log was
opened and when each cycle was recorded; this process stores when it kills. The loss is the time from the last
cycle in the log to the kill. The same run without a kill gives the duration, and the expected contents of a
log. Only kills of open logs count. Each log is also recovered.
"""

import mmap
import os
import signal
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

from marsarm.telemetry.errors import LogError
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.recover import recover
from sim.loop import ClosedLoop
from sim.placement import PlacementRun
from simgap.common.errors import BadOutput
from validation.campaigns import Context, Document
from validation.closed_loop import TARGET, placement_loop

CYCLES = 4000
BOUND_S = 0.020
STILL_S = 0.02
MOST_RUNS = 3
"""Largest number of runs for each kill that counts; a kill may be before the log is open, or too late."""


@dataclass(frozen=True, slots=True)
class Kill:
    """Run that was killed, and its log."""

    outcome: str
    """ "cut short", which counts; "not begun" or "closed" if no messages were open; or "wrong: ..."."""
    lost_s: float = 0.0
    """Wall time before the kill that the log lacks."""
    lost_cycles: int = 0
    """Cycles that were run and are not in the log; few if other processes used the lost time."""


def record_run(loop: ClosedLoop, path: Path, stamps_s: Any) -> None:
    """Record the beginning of a placement, and the times when the log was opened and each cycle recorded.

    Args:
        path: The log.
        stamps_s: Array for the times, shape (1 + CYCLES,), in seconds of the monotonic clock.
    """
    with Recorder(path, {"seed": "0"}, loop.config) as recorder:
        stamps_s[0] = time.monotonic()
        for number, record in enumerate(islice(PlacementRun(loop, TARGET), CYCLES), 1):
            recorder.write(record)
            stamps_s[number] = time.monotonic()


def start(loop: ClosedLoop, path: Path, stamps_s: Any) -> int:
    """Fork a run in its own process group, and return its process number."""
    child = os.fork()
    if child:
        return child
    os.setsid()
    record_run(loop, path, stamps_s)
    os._exit(0)


def is_start_of(log: Log, whole: Log) -> bool:
    """Check that a log holds the beginning of the complete one, bit for bit, and nothing else."""
    packets = all(
        rows.tobytes() == whole[topic][: len(rows)].tobytes() for topic, rows in log.packets.items()
    )
    times = all(np.array_equal(ns, whole.time_ns[topic][: len(ns)]) for topic, ns in log.time_ns.items())
    evrs, commands = whole.evrs[: len(log.evrs)], whole.commands[: len(log.commands)]
    return packets and times and log.evrs == evrs and log.commands == commands and log.header == whole.header


def is_recovered(path: Path, log: Log, whole: Log) -> bool:
    """Check that recovery makes a complete log of a truncated one, with all messages of its closed chunks."""
    try:
        recover(path, path.with_name("good.mcap"), lambda *_: None)
        good = read_log(path.with_name("good.mcap"))
    except (LogError, BadOutput):
        return False
    counts = [{topic: len(times) for topic, times in one.time_ns.items()} for one in (good, log)]
    return not good.truncated and is_start_of(good, whole) and counts[0] == counts[1]


def kill_at(child: int, at_s: float) -> float:
    """Kill the process group of a child at a time of the monotonic clock, and return the actual time."""
    time.sleep(max(0.0, at_s - time.monotonic()))
    killed_s = time.monotonic()
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:  # the child has not made its group yet
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return killed_s


def wait_until_still(path: Path) -> None:
    """Wait until a file does not grow any more: its writer is no child of this process, to be waited for."""
    sizes = [-1, -2]
    while sizes[-1] != sizes[-2]:
        time.sleep(STILL_S)
        sizes.append(path.stat().st_size if path.exists() else 0)


def one_kill(loop: ClosedLoop, path: Path, stamps_s: Any, after_s: float, whole: Log) -> Kill:
    """Kill a run at a time after its fork, and check its log.

    Args:
        path: The log.
        stamps_s: Array for the times of the run, shape (1 + CYCLES,).
        after_s: Time from the fork to the kill.
        whole: Log of the complete run.
    """
    stamps_s[:] = 0.0
    path.unlink(missing_ok=True)
    forked_s = time.monotonic()
    killed_s = kill_at(start(loop, path, stamps_s), forked_s + after_s)
    wait_until_still(path)
    stamp_count = int(np.count_nonzero(stamps_s))
    if stamp_count == 0 and not path.exists():
        return Kill("not begun")
    try:
        log = read_log(path)
    except LogError as error:
        return Kill(f"wrong: {error}")
    if not is_start_of(log, whole):
        return Kill("wrong: not what the run was")
    if not log.truncated:
        return Kill("closed" if len(log["/joint"]) == CYCLES else "wrong: closed before the end of the run")
    if not any(len(times) for times in log.time_ns.values()):
        return Kill("not begun")  # a header alone has nothing to recover, and recovery says so
    if not is_recovered(path, log, whole):
        return Kill("wrong: not all of it was recovered")
    logged = len(log.packets.get("/joint", ()))
    if logged >= stamp_count:
        return Kill("cut short")
    # If this process was interrupted between reading the clock and the kill, the last stamp is later.
    lost_s = max(killed_s, float(stamps_s[stamp_count - 1])) - float(stamps_s[logged])
    return Kill("cut short", lost_s, stamp_count - 1 - logged)


def kill_runs(number: int, seed: int) -> Iterator[Kill]:
    """Kill runs until `number` kills have hit an open log or failed a check, or too many runs have not."""
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
            if kill.outcome == "closed":  # update the duration: the speed of the machine varies
                lengths_s.append(float(stamps_s[-1]) - forked_s)
            counted += kill.outcome not in ("closed", "not begun")
            if counted == number:
                return


def spread(losses: Sequence[float]) -> dict[str, float] | None:
    """Return median, 99th percentile and maximum of losses; None if there is none."""
    if not losses:
        return None
    return {
        "median": float(median(losses)),
        "p99": float(np.percentile(losses, 99)),
        "max": float(max(losses)),
    }


def campaign(context: Context, kills: int = 200) -> Document:
    """Kill runs until so many logs were open; in bounds if none is wrong or lost too much."""
    with warnings.catch_warnings():  # Python warns of a fork with idle library threads
        warnings.simplefilter("ignore", DeprecationWarning)
        found = list(kill_runs(kills, context.seed))
    outcomes = [kill.outcome for kill in found]
    truncated = [kill for kill in found if kill.outcome == "cut short"]
    lost_ms = [1e3 * kill.lost_s for kill in truncated]
    wrong = [outcome for outcome in outcomes if outcome.startswith("wrong")]
    counts = {name: outcomes.count(name) for name in ("cut short", "closed", "not begun")}
    return {
        "runs": len(found),
        "kills": len(truncated) + len(wrong),
        "outcomes": {**counts, "wrong": len(wrong)},
        "wrong": wrong,
        "lost_ms": spread(lost_ms),
        "lost_cycles": spread([kill.lost_cycles for kill in truncated]),
        "beyond_bound": sum(one > 1e3 * BOUND_S for one in lost_ms),
        "bound_ms": 1e3 * BOUND_S,
        "load_average": os.getloadavg()[0],
        "in_bounds": not wrong and max(lost_ms, default=0.0) <= 1e3 * BOUND_S and len(truncated) == kills,
    }
