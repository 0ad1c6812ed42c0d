"""Campaigns of broken logs: damaged ones, and those of killed runs.

Damage: single bits are flipped, and the file is truncated. Each damage must be harmless, with every value as
it was written, or be detected. Recovery must save every message of the undamaged chunks, must not change a
value, and must report when what it lost was recorded.

Kills: SIGKILL to the whole process group at random times, and a check of the log. Each run is a fork of this
process, in its own process group. It counts in shared memory the cycles that it has recorded. The loss is the
Mars time of those that the log lacks. The same run without a kill gives the duration, and the expected
contents of a log. Only kills of open logs count. Each log is read by the reader of the library too,
recovered, and replayed.
"""

import mmap
import os
import signal
import struct
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from marsarm.replaying.replay import ReplayRequest, replay
from marsarm.telemetry.errors import LogDamaged, LogError, LogNotReadable, LostMessages
from marsarm.telemetry.header import run_header
from marsarm.telemetry.mcap_columns import read_records, unpack_chunk
from marsarm.telemetry.read import Log, parse_log, read_log
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.recover import recover
from sim.loop import ClosedLoop
from sim.placement import PlacementRun
from simgap.common.errors import BadOutput
from validation.campaigns import Context, Document
from validation.speed import TARGET, placement_loop, record_log

CUT_EVERY: Final = 4096
HERE: Final = Path("damaged.mcap")


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Chunk with messages: bytes of its record, and its log times."""

    at: int
    end: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Original:
    """Undamaged file: bytes, contents, and places of chunks with messages."""

    data: bytes
    log: Log
    chunks: tuple[ChunkPlace, ...]


def original(data: bytes) -> Original:
    """Parse an undamaged file, complete or truncated."""
    chunks = (
        ChunkPlace(at, data.index(one.data, at) + len(one.data), one.message_start_time, one.message_end_time)
        for at, one in read_records(data).chunks
        if unpack_chunk(one)[0] == Opcode.MESSAGE
    )
    return Original(data, parse_log(HERE, data), tuple(chunks))


def count_messages(log: Log) -> dict[str, int]:
    """Return the number of messages by topic."""
    return {topic: len(times) for topic, times in log.time_ns.items()}


def is_start_of(log: Log, whole: Log) -> bool:
    """Check that a log holds the beginning of the complete one, bit for bit, and nothing else."""
    packets = all(
        rows.tobytes() == whole[topic][: len(rows)].tobytes() for topic, rows in log.packets.items()
    )
    times = all(np.array_equal(ns, whole.time_ns[topic][: len(ns)]) for topic, ns in log.time_ns.items())
    evrs, commands = whole.evrs[: len(log.evrs)], whole.commands[: len(log.commands)]
    return packets and times and log.evrs == evrs and log.commands == commands and log.header == whole.header


def packet_bytes(packets: NDArray[np.void]) -> NDArray[np.uint8]:
    """Return all bytes of packets, shape (n, bytes), with the padding between fields."""
    return packets.view(np.uint8).reshape(len(packets), packets.dtype.itemsize)


def is_part(log: Log, written: Log) -> bool:
    """Check that every message of a log was written with these values."""
    for topic, packets in log.packets.items():
        rows = np.searchsorted(written.time_ns[topic], log.time_ns[topic])
        at_its_time = np.array_equal(written.time_ns[topic][rows % len(written[topic])], log.time_ns[topic])
        if not at_its_time or not np.array_equal(packet_bytes(packets), packet_bytes(written[topic])[rows]):
            return False
    return set(log.evrs) <= set(written.evrs) and set(log.commands) <= set(written.commands)


def is_loss_reported(
    here_ns: Mapping[str, NDArray[np.uint64]], written: Log, lost: tuple[LostMessages, ...]
) -> bool:
    """Check that every message is here, by its log time, (n,) by topic, or within a reported span."""
    for topic, times in written.time_ns.items():
        here = here_ns.get(topic, np.zeros(0, np.uint64))
        spans = [one for one in lost if one.topic in (topic, None)]
        for time_ns in np.setdiff1d(times, here).tolist():
            # A cycle may have several EVRs, so the ends of a span belong to it.
            if not any(
                (one.after_ns is None or one.after_ns <= time_ns)
                and (one.before_ns is None or time_ns <= one.before_ns)
                for one in spans
            ):
                return False
    return True


def judge_read(made: Original, damaged: bytes, cut_ns: int | None = None) -> str:
    """Judge a strict read of a damaged file, of which `cut_ns` is the log time of its last complete chunk.

    Returns:
        "harmless", "detected", "refused" or "cut", or a description of the error that begins with "WRONG".
    """
    try:
        log = parse_log(HERE, damaged)
    except LogDamaged:
        return "detected"
    except LogNotReadable:
        return "refused"
    except LogError as error:
        return f"WRONG: {error}"
    if count_messages(log) == count_messages(made.log) and is_start_of(log, made.log):
        return "harmless"
    if cut_ns is None or not log.truncated:
        return "WRONG: other values"
    whole = all(
        np.array_equal(log.time_ns.get(topic, np.zeros(0)), times[times <= cut_ns])
        for topic, times in made.log.time_ns.items()
    )
    return "cut" if whole and is_part(log, made.log) else "WRONG: not all that is before the cut"


def judge_recovery(made: Original, damaged: bytes, is_hit: list[bool], folder: Path) -> str:
    """Judge the recovery of a damaged file, with a flag for each chunk that is damaged.

    Returns:
        "saved" or "nothing to save", or a description of the error that begins with "WRONG".
    """
    bad, good = folder / "bad.mcap", folder / "good.mcap"
    bad.write_bytes(damaged)
    try:
        recovered = recover(bad, good, lambda *_: None)
    except LogError as error:
        return "nothing to save" if all(is_hit) else f"WRONG: {error}"
    log = parse_log(good, good.read_bytes())
    if not is_part(log, made.log):
        return "WRONG: other values"
    missed = sum(map(len, made.log.time_ns.values())) - sum(recovered.saved.values())
    spans = [(one.first_ns, one.last_ns) for one, hit in zip(made.chunks, is_hit, strict=True) if hit]
    due = sum(
        int(sum(((low <= times) & (times <= high)).sum() for times in made.log.time_ns.values()))
        for low, high in spans
    )
    if missed > due:
        return f"WRONG: {missed} messages missing, {due} were damaged"
    return "saved" if is_loss_reported(log.time_ns, made.log, recovered.lost) else "WRONG: a loss is not told"


def flip_bits(made: Original, tries: int, seed: int, folder: Path) -> dict[str, Any]:
    """Flip single bits, one at a time, and count the judgements."""
    reads, saves, wrong = Counter[str](), Counter[str](), []
    random = np.random.default_rng(seed)
    offsets, bits = random.integers(len(made.data), size=tries), random.integers(8, size=tries)
    for at, bit in zip(offsets, bits, strict=True):
        damaged = bytearray(made.data)
        damaged[at] ^= 1 << int(bit)
        is_hit = [one.at <= at < one.end for one in made.chunks]
        read, save = judge_read(made, bytes(damaged)), judge_recovery(made, bytes(damaged), is_hit, folder)
        reads[read] += 1
        saves[save] += 1
        if "WRONG" in read + save:
            wrong.append({"byte": int(at), "bit": int(bit), "read": read, "saved": save})
    return {"read": dict(reads), "recovered": dict(saves), "wrong": wrong}


def truncate_file(made: Original, every: int, folder: Path) -> dict[str, Any]:
    """Truncate the file at multiples of `every` bytes, and count the judgements."""
    reads, saves, wrong = Counter[str](), Counter[str](), []
    for size in range(0, len(made.data), every):
        damaged = made.data[:size]
        is_hit = [one.end > size for one in made.chunks]
        whole = [one.last_ns for one in made.chunks if one.end <= size]
        read = judge_read(made, damaged, max(whole, default=-1))
        save = judge_recovery(made, damaged, is_hit, folder)
        reads[read] += 1
        saves[save] += 1
        if "WRONG" in read + save:
            wrong.append({"size": size, "read": read, "saved": save})
    return {"read": dict(reads), "recovered": dict(saves), "wrong": wrong}


def damage(context: Context, cycles: int = 320, tries: int = 1000, chunk_cycles: int = 1) -> Document:
    """Damage a complete log and a truncated one in every way."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        data = record_log(folder / "run.mcap", cycles, chunk_cycles).read_bytes()
        whole = original(data)
        last = whole.chunks[len(whole.chunks) * 3 // 5]
        cut = original(data[: (last.at + last.end) // 2])
        parts = {
            "bits_closed": flip_bits(whole, tries, context.seed, folder),
            "bits_cut_short": flip_bits(cut, tries, context.seed + 1, folder),
            "truncated": truncate_file(whole, CUT_EVERY, folder),
        }
    sizes = {"cycles": cycles, "bytes": len(data), "chunks": len(whole.chunks)}
    return {**sizes, **parts, "in_bounds": not any(part["wrong"] for part in parts.values())}


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


def fork_run(loop: ClosedLoop, header: Mapping[str, str], path: Path, recorded: Any) -> int:
    """Fork a run in its own process group, and return its process number."""
    child = os.fork()
    if child:
        return child
    os.setsid()
    record_run(loop, header, path, recorded)
    os._exit(0)


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
    counts = count_messages(log)
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
    if copy.truncated or count_messages(copy) != counts:
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
    """Check the log of a killed run by the number of recorded cycles and the log of the complete run."""
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
        os.waitpid(fork_run(loop, header, path, recorded), 0)
        lengths_s = [time.monotonic() - forked_s]
        whole = read_log(path)
        counted = 0
        for part in random.uniform(0.0, 1.0, MOST_RUNS * number):
            recorded[0] = 0
            path.unlink(missing_ok=True)
            forked_s = time.monotonic()
            kill_at(fork_run(loop, header, path, recorded), forked_s + part * median(lengths_s))
            kill = judge_kill(path, int(recorded[0]), whole)
            yield kill
            counted += kill.outcome not in ("closed", "not begun")
            if counted == number:
                return


def killed(context: Context, kills: int = 200) -> Document:
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
