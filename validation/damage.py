"""Campaign of damaged logs: single bits flipped, and the file truncated.

Each damage must be harmless, with every value as it was written, or be detected. Recovery must save every
message of the undamaged chunks, must not change a value, and must report when what it lost was recorded.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from marsarm.telemetry.errors import LogDamaged, LogError, LogNotReadable, LostMessages
from marsarm.telemetry.mcap_columns import read_records, unpack_chunk
from marsarm.telemetry.read import Log, parse_log
from marsarm.telemetry.recover import recover
from validation.campaigns import Context, Document
from validation.speed import record_log

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


def is_same_log(log: Log, written: Log) -> bool:
    """Check that a log holds all that was written, bit for bit."""
    return (
        log.header == written.header
        and log.time_ns.keys() == written.time_ns.keys()
        and all(np.array_equal(log.time_ns[topic], times) for topic, times in written.time_ns.items())
        and all(log[topic].tobytes() == packets.tobytes() for topic, packets in written.packets.items())
        and (log.evrs, log.commands) == (written.evrs, written.commands)
    )


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
    """Check that every missing message is within a reported time span.

    Args:
        here_ns: Log times of the messages that are present, shape (n,), by topic.
        written: The undamaged log.
        lost: The reported spans.
    """
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
    """Judge a strict read of a damaged file.

    Args:
        made: The undamaged file.
        cut_ns: Log time up to which a truncated file holds complete chunks.

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
    if is_same_log(log, made.log):
        return "harmless"
    if cut_ns is None or not log.truncated:
        return "WRONG: other values"
    whole = all(
        np.array_equal(log.time_ns.get(topic, np.zeros(0)), times[times <= cut_ns])
        for topic, times in made.log.time_ns.items()
    )
    return "cut" if whole and is_part(log, made.log) else "WRONG: not all that is before the cut"


def judge_recovery(made: Original, damaged: bytes, is_hit: list[bool], folder: Path) -> str:
    """Judge the recovery of a damaged file.

    Args:
        made: The undamaged file.
        is_hit: True for each damaged chunk.
        folder: Folder for temporary files.

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


def flips(made: Original, tries: int, seed: int) -> Iterator[tuple[int, int]]:
    """Draw offsets of bytes, and bits in them, to flip."""
    random = np.random.default_rng(seed)
    yield from zip(random.integers(len(made.data), size=tries), random.integers(8, size=tries), strict=True)


def flip_bits(made: Original, tries: int, seed: int, folder: Path) -> dict[str, Any]:
    """Flip single bits, one at a time, and count the judgements."""
    reads, saves, wrong = Counter[str](), Counter[str](), []
    for at, bit in flips(made, tries, seed):
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


def campaign(context: Context, cycles: int = 320, tries: int = 1000, chunk_cycles: int = 1) -> Document:
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
