"""Fuzzing of the log reader and the importer with corrupt files: any reaction but a proper error is a bug.

A seeded mutator changes valid files at random.
"""

import faulthandler
import hashlib
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from marsarm.telemetry.errors import LogError
from marsarm.telemetry.inspection import select_channels
from marsarm.telemetry.read import parse_log
from marsarm.telemetry.recover import recover
from marsarm.telemetry.tables import channels_document, info_document
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document
from validation.fuzz_inputs import (
    Random,
    import_once,
    import_seeds,
    mutate_bytes,
    mutate_import,
    mutate_records,
)
from validation.speed import record_log

MEMORY_BYTES: Final = 4 << 30
"""Limit of the address space, with libraries and their threads."""
SLOWEST_S: Final = 10.0
"""Time limit of one input; the longest input of the mutator takes a tenth of it."""
MOST_BYTES: Final = 1 << 30
"""Limit of the growth in memory of the process for one input."""
SEED_CYCLES: Final = 24
POOL: Final = 64
"""Largest number of inputs to mutate: the seeds, and accepted inputs."""


class TooSlow(BaseException):
    """Error for an input over the time limit; no Exception, because a target may catch those."""


@dataclass(frozen=True, slots=True)
class FuzzTarget:
    """Function to fuzz."""

    name: str
    run: Callable[[bytes], bool]
    """Function of the bytes of a file: True if it accepts them, False if it refuses them."""
    seeds: Callable[[], list[bytes]]
    """Function that makes valid files to begin with."""
    mutate: Callable[[Random, bytes], bytes] = mutate_bytes


def fuzz_reader(data: bytes) -> bool:
    """Recover a log, read it, and inspect all that it holds."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fuzz.mcap"
        path.write_bytes(data)
        with suppress(LogError):
            recover(path, path.with_name("good.mcap"), lambda *_: None)
    try:
        log = parse_log(path, data)
    except LogError:
        return False
    info_document(log)
    channels_document(log, select_channels(log))
    return True


def log_seeds() -> list[bytes]:
    """Make a complete log, its first half, and a log without a cycle."""
    with TemporaryDirectory() as folder:
        data = record_log(Path(folder) / "run.mcap", SEED_CYCLES, 1).read_bytes()
        empty = record_log(Path(folder) / "run.mcap", 0).read_bytes()
    return [data, data[: len(data) // 2], empty]


def mutate_log(random: Random, data: bytes) -> bytes:
    """Mutate the bytes of a log, or the contents of its records."""
    return (mutate_records if random.random() < 0.6 else mutate_bytes)(random, data)


TARGETS: Final = (
    FuzzTarget("reader", fuzz_reader, log_seeds, mutate_log),
    FuzzTarget("importer", import_once, import_seeds, mutate_import),
)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TooSlow if the block takes longer; exit the process if a library blocks the signal."""

    def stop(*_: Any) -> None:
        raise TooSlow(f"longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    faulthandler.dump_traceback_later(3 * seconds, exit=True, file=sys.__stderr__ or sys.stderr)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def fuzz(target: FuzzTarget, seed: int, seconds: float, most: int | None = None) -> Document:
    """Mutate inputs at random until the time is over, `most` are tried, or a bug is found.

    Accepted inputs are mutated again. Time and memory are measured outside the target.
    """
    random = np.random.default_rng(seed)
    pool, accepted, tries, slowest_s, largest_bytes = target.seeds(), 0, 0, 0.0, 0
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s and tries != most:
        data = target.mutate(random, pool[int(random.integers(len(pool)))])
        file = write_input(target, data)  # written before the trial, because some bugs end the process
        began_s, bytes_before = time.monotonic(), peak_bytes()
        try:
            with time_limit(SLOWEST_S):
                is_accepted = target.run(data)
            took_s, grown_bytes = time.monotonic() - began_s, peak_bytes() - bytes_before
            check_cost(took_s, grown_bytes)
        except (Exception, TooSlow):
            return {"tries": tries, "failed": str(file), "why": traceback.format_exc()}
        file.unlink()
        slowest_s, largest_bytes = max(slowest_s, took_s), max(largest_bytes, grown_bytes)
        tries += 1
        accepted += is_accepted
        if is_accepted and len(pool) < POOL:
            pool.append(data)
    return {
        "tries": tries,
        "accepted": accepted,
        "slowest_s": slowest_s,
        "largest_bytes": largest_bytes,
        "failed": None,
    }


def peak_bytes() -> int:
    """Return the peak memory of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10  # KiB on Linux


def check_cost(took_s: float, grown_bytes: int) -> None:
    """Raise TooSlow or MemoryError if an input exceeded a limit."""
    if took_s > SLOWEST_S:
        raise TooSlow(f"took {took_s:.1f} s, longer than {SLOWEST_S} s")
    if grown_bytes > MOST_BYTES:
        raise MemoryError(f"the process grew by {grown_bytes} bytes, by more than {MOST_BYTES}")


def write_input(target: FuzzTarget, data: bytes) -> Path:
    """Write an input to a file, and return its path."""
    path = Path(f"fuzz-{target.name}-{hashlib.sha256(data).hexdigest()[:12]}.bin")
    path.write_bytes(data)
    return path


def campaign(context: Context, seconds: float = 60.0, target: str = "") -> Document:
    """Fuzz all targets, or one; in bounds if no bug was found.

    Args:
        context: Gives the seed of the mutations.
        seconds: Time for all targets together.
        target: Name of a target; empty for all.
    """
    chosen = [one for one in TARGETS if target in ("", one.name)]
    if not chosen:
        raise BadRequest(f"set target: there are {', '.join(one.name for one in TARGETS)}")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    found = {one.name: fuzz(one, context.seed, seconds / len(chosen)) for one in chosen}
    is_good = all(one["failed"] is None for one in found.values())
    return {"targets": found, "in_bounds": is_good}
