"""Campaign of killed runs: SIGKILL to the whole process group at random times, and a check of the log.

Each run is a fork of this process, in its own process group. It counts in shared memory the cycles that it
has recorded. The loss is the Mars time of those that the log lacks. The same run without a kill gives the
duration, and the expected contents of a log. Only kills of open logs count. Each log is read by the reader of
the library too, recovered, and replayed.
"""

import mmap
import os
import signal
import struct
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from fsw.config import CYCLE_HZ
from marsarm.replay.replay import ReplayRequest, replay
from marsarm.telemetry.errors import LogError
from marsarm.telemetry.header import run_header
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.recover import recover
from sim.loop import ClosedLoop
from sim.placement import PlacementRun
from simgap.common.errors import BadOutput
from validation.campaigns import Context, Document
from validation.speed import TARGET, placement_loop

CYCLES = 4000
BOUND_S = 1.2
"""Largest Mars time that a killed run may lose."""
MOST_RUNS = 3
"""Largest number of runs for each kill that counts; a kill may be before the log is open, or too late."""


@dataclass(frozen=True, slots=True)
class Kill:
    """Run that was killed, and its log."""

    outcome: str
    """ "cut short", which counts; "not begun" or "closed" if no messages were open; or "wrong: ..."."""
    lost_s: float = 0.0
    """Mars time of the recorded cycles that the log lacks."""


def record_run(loop: ClosedLoop, header: Mapping[str, str], path: Path, recorded: Any) -> None:
    """Record the beginning of a placement; `recorded`, shape (1,), counts the cycles."""
    with Recorder(path, header, loop.config) as recorder:
        for number, record in enumerate(islice(PlacementRun(loop, TARGET), CYCLES), 1):
            recorder.write(record)
            recorded[0] = number


def start(loop: ClosedLoop, header: Mapping[str, str], path: Path, recorded: Any) -> int:
    """Fork a run in its own process group, and return its process number."""
    child = os.fork()
    if child:
        return child
    os.setsid()
    record_run(loop, header, path, recorded)
    os._exit(0)


def is_start_of(log: Log, whole: Log) -> bool:
    """Check that a log holds the beginning of the complete one, bit for bit, and nothing else."""
    packets = all(
        rows.tobytes() == whole[topic][: len(rows)].tobytes() for topic, rows in log.packets.items()
    )
    times = all(np.array_equal(ns, whole.time_ns[topic][: len(ns)]) for topic, ns in log.time_ns.items())
    evrs, commands = whole.evrs[: len(log.evrs)], whole.commands[: len(log.commands)]
    return packets and times and log.evrs == evrs and log.commands == commands and log.header == whole.header


def stock_counts(path: Path) -> dict[str, int]:
    """Return the number of messages by topic that the reader of the library finds before the cut."""
    counts: dict[str, int] = {}
    with path.open("rb") as file:
        try:
            for _, channel, _ in NonSeekingReader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            ):
                counts[channel.topic] = counts.get(channel.topic, 0) + 1
        except (McapError, ValueError, struct.error):  # the cut
            pass
    return counts


def find_fault(path: Path, log: Log, whole: Log) -> str:
    """Return what is wrong with a truncated log, or with its copy; empty if nothing is."""
    counts = {topic: len(times) for topic, times in log.time_ns.items()}
    if not is_start_of(log, whole):
        return "not what the run was"
    if not counts.items() <= stock_counts(path).items():
        return "the reader of the library finds other messages"
    good = path.with_name("good.mcap")
    try:
        recover(path, good, lambda *_: None)
        copy = read_log(good)
    except (LogError, BadOutput) as error:
        return f"not recovered: {error}"
    if copy.truncated or {topic: len(times) for topic, times in copy.time_ns.items()} != counts:
        return "not all of it was recovered"
    if not is_start_of(copy, whole):
        return "recovered as something else"
    if not replay(ReplayRequest(good)).differences.identical:
        return "its replay differs"
    return ""


def kill_at(child: int, at_s: float) -> None:
    """Kill the process group of a child at a time of the monotonic clock."""
    time.sleep(max(0.0, at_s - time.monotonic()))
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:  # the child has not made its group yet
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


def judge_kill(path: Path, recorded: int, whole: Log) -> Kill:
    """Check the log of a killed run.

    Args:
        path: The log.
        recorded: Number of cycles that were recorded.
        whole: Log of the complete run.
    """
    if not path.exists():
        return Kill("not begun")
    try:
        log = read_log(path)
    except LogError as error:
        return Kill(f"wrong: {error}")
    if not log.truncated:
        return Kill("closed" if len(log["/joint"]) == CYCLES else "wrong: closed before the end of the run")
    lost_s = (recorded - len(log.packets.get("/joint", ()))) / CYCLE_HZ
    if not log.time_ns:
        return Kill("not begun" if lost_s <= BOUND_S else "wrong: no chunk was closed")
    fault = find_fault(path, log, whole)
    return Kill(f"wrong: {fault}" if fault else "cut short", lost_s)


def kill_runs(number: int, seed: int) -> Iterator[Kill]:
    """Kill runs until `number` kills have hit an open log or failed a check, or too many runs have not."""
    random = np.random.default_rng(seed)
    recorded = np.frombuffer(mmap.mmap(-1, 8), np.int64)
    loop = placement_loop(with_truth=True)
    header = run_header(loop, "nominal", 0, {}, ())
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        forked_s = time.monotonic()
        os.waitpid(start(loop, header, path, recorded), 0)
        lengths_s = [time.monotonic() - forked_s]
        whole = read_log(path)
        counted = 0
        for part in random.uniform(0.0, 1.0, MOST_RUNS * number):
            recorded[0] = 0
            path.unlink(missing_ok=True)
            forked_s = time.monotonic()
            kill_at(start(loop, header, path, recorded), forked_s + part * median(lengths_s))
            kill = judge_kill(path, int(recorded[0]), whole)
            yield kill
            counted += kill.outcome not in ("closed", "not begun")
            if counted == number:
                return


def campaign(context: Context, kills: int = 200) -> Document:
    """Kill runs until so many logs were open; in bounds if none is wrong or lost too much."""
    with warnings.catch_warnings():  # Python warns of a fork with idle library threads
        warnings.simplefilter("ignore", DeprecationWarning)
        found = list(kill_runs(kills, context.seed))
    outcomes = [kill.outcome for kill in found]
    lost_s = [kill.lost_s for kill in found if kill.outcome == "cut short"]
    wrong = [outcome for outcome in outcomes if outcome.startswith("wrong")]
    counts = {name: outcomes.count(name) for name in ("cut short", "closed", "not begun")}
    return {
        "runs": len(found),
        "kills": len(lost_s) + len(wrong),
        "outcomes": {**counts, "wrong": len(wrong)},
        "wrong": wrong,
        "lost_s": {"median": median(lost_s), "max": max(lost_s)} if lost_s else None,
        "beyond_bound": sum(one > BOUND_S for one in lost_s),
        "bound_s": BOUND_S,
        "in_bounds": not wrong and max(lost_s, default=0.0) <= BOUND_S and len(lost_s) == kills,
    }
