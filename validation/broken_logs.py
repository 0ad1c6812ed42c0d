"""Campaign of broken logs: flipped bits, files cut short as by a killed run, and records that do not fit.

Each flip and cut must be harmless, with every value as it was written, or be detected. Recovery must save
every message of the undamaged chunks, must not change a value, and must report when the lost was recorded.
The reader of the library must find all that is before a cut, too. A record that was changed with its CRC is
read or refused, in the time and memory of a few logs.
"""

import resource
import struct
import time
import zlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from numpy.typing import NDArray

from marsarm.telemetry import format
from marsarm.telemetry.inspection import select_channels
from marsarm.telemetry.log_writer import RECORD_HEAD, encode_records
from marsarm.telemetry.mcap_columns import read_records, unpack_chunk
from marsarm.telemetry.read import Log, parse_log, read_log
from marsarm.telemetry.recover import recover
from marsarm.telemetry.tables import channels_document, info_document
from simgap.common.progress import no_progress
from validation.benchmarks import record_log
from validation.campaigns import Context, Document

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
    here_ns: Mapping[str, NDArray[np.uint64]], written: Log, lost: tuple[format.LostMessages, ...]
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


def judge_read(made: Original, damaged: bytes, cut_ns: int | None) -> str:
    """Judge a strict read of a damaged file, of which `cut_ns` is the log time of its last complete chunk.

    It is "harmless", "detected", "refused" or "cut", or an error, whose text begins with "WRONG".
    """
    try:
        log = parse_log(HERE, damaged)
    except format.LogDamaged:
        return "detected"
    except format.LogNotReadable:
        return "refused"
    except format.LogError as error:
        return f"WRONG: {error}"
    if not is_part(log, made.log) or log.header != made.log.header:
        return "WRONG: other values"
    if count_messages(log) == count_messages(made.log):
        return "harmless"
    if cut_ns is None or not log.truncated:
        return "WRONG: messages are missing"
    due = {topic: int((times <= cut_ns).sum()) for topic, times in made.log.time_ns.items()}
    return "cut" if count_messages(log) == +Counter(due) else "WRONG: not all that is before the cut"


def count_messages(log: Log) -> Counter[str]:
    """Return the number of messages by topic."""
    return Counter({topic: len(times) for topic, times in log.time_ns.items()})


def judge_recovery(made: Original, damaged: bytes, is_hit: list[bool], folder: Path) -> str:
    """Judge the recovery of a damaged file, with a flag for each chunk that is damaged.

    It is "saved" or "nothing to save", or an error, whose text begins with "WRONG".
    """
    bad, good = folder / "bad.mcap", folder / "good.mcap"
    bad.write_bytes(damaged)
    try:
        recovered = recover(bad, good, no_progress)
    except format.LogError as error:
        return "nothing to save" if all(is_hit) else f"WRONG: {error}"
    log = parse_log(good, good.read_bytes())
    if not is_part(log, made.log):
        return "WRONG: other values"
    missed = count_messages(made.log).total() - sum(recovered.saved.values())
    spans = [(one.first_ns, one.last_ns) for one, hit in zip(made.chunks, is_hit, strict=True) if hit]
    times = np.concatenate([*made.log.time_ns.values()])
    due = sum(int(((low <= times) & (times <= high)).sum()) for low, high in spans)
    if missed > due:
        return f"WRONG: {missed} messages missing, {due} were damaged"
    return "saved" if is_loss_reported(log.time_ns, made.log, recovered.lost) else "WRONG: a loss is not told"


@dataclass(slots=True)
class Judgements:
    """Judgements that were counted, and the wrong ones."""

    read: Counter[str] = field(default_factory=Counter)
    recovered: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def add(self, place: str, read: str, recovered: str) -> None:
        """Count what became of a file that was damaged at a place."""
        self.read[read.partition(":")[0]] += 1
        self.recovered[recovered.partition(":")[0]] += 1
        if "WRONG" in read + recovered:
            self.wrong.append(f"{place}: read {read}, recovered {recovered}")


def flip_bits(made: Original, tries: int, seed: int, folder: Path) -> Judgements:
    """Flip single bits, one at a time, and count the judgements."""
    found, random = Judgements(), np.random.default_rng(seed)
    offsets, bits = random.integers(len(made.data), size=tries), random.integers(8, size=tries)
    for at, bit in zip(offsets.tolist(), bits.tolist(), strict=True):
        damaged = bytearray(made.data)
        damaged[at] ^= 1 << bit
        is_hit = [one.at <= at < one.end for one in made.chunks]
        read = judge_read(made, bytes(damaged), None)
        found.add(f"byte {at}, bit {bit}", read, judge_recovery(made, bytes(damaged), is_hit, folder))
    return found


def is_in_stock(path: Path, log: Log) -> bool:
    """Check that the reader of the library finds as many messages of each topic before the cut."""
    counts = Counter[str]()
    with path.open("rb") as file:
        try:
            reader = NonSeekingReader(file, validate_crcs=True)
            for _, channel, _ in reader.iter_messages(log_time_order=False):
                counts[channel.topic] += 1
        except (McapError, ValueError, struct.error):  # the cut
            pass
    return count_messages(log) <= counts


def truncate_file(made: Original, every: int, folder: Path) -> Judgements:
    """Truncate the file at multiples of `every` bytes, and count the judgements."""
    found = Judgements()
    for size in range(0, len(made.data), every):
        damaged = made.data[:size]
        read = judge_read(made, damaged, max((o.last_ns for o in made.chunks if o.end <= size), default=-1))
        saved = judge_recovery(made, damaged, [one.end > size for one in made.chunks], folder)
        if read == "cut" and not is_in_stock(folder / "bad.mcap", parse_log(HERE, damaged)):
            read = "WRONG: the reader of the library does not find all of it"
        found.add(f"{size} bytes", read, saved)
    return found


Random = np.random.Generator
NUMBERS: Final = (0, 1, 0x80, 1 << 40, *((1 << bits) - 1 for bits in (7, 8, 16, 31, 32, 63, 64)))
"""Values that lengths and offsets are likely to mishandle."""
MOST_BYTES: Final = 1 << 30
"""Largest growth in memory of the process for one log."""
MOST_S: Final = 10.0
"""Longest processor time of one log."""


def change_bytes(random: Random, data: bytes) -> bytes:
    """Flip, overwrite, cut or repeat one to three parts of some bytes."""
    out = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        at, to = (int(one) for one in random.integers(len(out) + 1, size=2))
        match int(random.integers(5)):
            case 0 if at < len(out):
                out[at] ^= 1 << int(random.integers(8))
            case 1:
                size = int(random.choice((1, 2, 4, 8)))
                value = int(NUMBERS[int(random.integers(len(NUMBERS)))]) & ((1 << 8 * size) - 1)
                out[at : at + size] = value.to_bytes(size, "little")
            case 2:
                del out[at : at + int(random.integers(1, 256)) if random.random() < 0.7 else None]
            case 3:
                out[to:to] = out[at : at + int(random.integers(1, 4096))]
            case _:
                out[at : at + 16] = random.bytes(int(random.integers(1, 32)))
    return bytes(out)


def change_record(random: Random, made: Original) -> bytes:
    """Change the messages of a chunk, or a text of the header, together with their CRC."""
    if random.random() < 0.2:
        return change_header(random, made.data)
    chunks = read_records(made.data).chunks
    at, chunk = chunks[int(random.integers(len(chunks)))]
    plain = change_bytes(random, unpack_chunk(chunk))
    packed, crc = zstandard.compress(plain), zlib.crc32(plain)
    changed = replace(chunk, data=packed, uncompressed_size=len(plain), uncompressed_crc=crc)
    end = made.data.index(chunk.data, at) + len(chunk.data)
    return made.data[:at] + encode_records(changed) + made.data[end:]


def change_header(random: Random, data: bytes) -> bytes:
    """Change a text of the header, together with its CRC."""
    header = read_records(data).metadata[format.HEADER_RECORD]
    name = sorted(header)[int(random.integers(len(header)))]
    text = change_bytes(random, header[name].encode()).decode("latin-1")
    begin = data.index(format.FORMAT_RECORD.encode()) - RECORD_HEAD.size - 4
    end = data.index(format.HEADER_RECORD.encode(), begin) - 4
    end += RECORD_HEAD.unpack_from(data, end - RECORD_HEAD.size)[1]
    return data[:begin] + encode_records(*format.header_records({**header, name: text})) + data[end:]


def change_records(made: Original, tries: int, seed: int, folder: Path) -> Judgements:
    """Recover, read and inspect logs with changed records; any error but that of a log is a bug."""
    random, found = np.random.default_rng(seed), Judgements()
    path = folder / "changed.mcap"
    for number in range(tries):
        path.write_bytes(change_record(random, made))
        began_s, bytes_before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
        read = "read"
        try:
            with suppress(format.LogError):
                recover(path, folder / "good.mcap", no_progress)
            log = read_log(path)
            info_document(log)
            channels_document(log, select_channels(log))
        except format.LogError:
            read = "refused"
        except Exception as error:
            read = f"WRONG: {type(error).__name__}: {error}"
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10) - bytes_before
        if time.process_time() - began_s > MOST_S or grown > MOST_BYTES:
            read = f"WRONG: took {time.process_time() - began_s:.1f} s and {grown} bytes"
        found.add(f"try {number}", read, "tried")
    return found


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
            "records": change_records(cut, tries, context.seed + 2, folder),
        }
    sizes = {"cycles": cycles, "bytes": len(data), "chunks": len(whole.chunks)}
    return {**sizes, **parts, "in_bounds": not any(one.wrong for one in parts.values())}
