"""Strict reader of logs into numpy arrays: it returns what was written, or reports the damage."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from marsarm.telemetry.events import CommandEntry, EvrEntry
from marsarm.telemetry.format import (
    COMMAND_TOPIC,
    END_RECORD,
    EVR_TOPIC,
    FORMAT_RECORD,
    HEADER_RECORD,
    INTERRUPTED_KEY,
    RECOVERED_RECORD,
    TICK_NS,
    LogDamaged,
    LogNotReadable,
    LostMessages,
    header_crc32,
    losses_in,
    version_problem,
    without_crc,
)
from marsarm.telemetry.mcap_columns import (
    MESSAGE_DTYPE,
    PARSE_ERRORS,
    CorruptData,
    McapContent,
    read_batches,
    read_records,
)
from marsarm.telemetry.topics import TopicSpec, decode_topics
from simgap.common.errors import RobotError
from simgap.common.files import read_bytes

NO_MCAP: Final = (
    "not an MCAP file; `marsarm run --log run.mcap` writes one; `marsarm log import` makes one of a table, "
    "for diagnose, export or Python, not for view or replay"
)

MAX_UNPACKED_BYTES: Final = 1 << 33
"""Limit of bytes decompressed at once: a day of telemetry. A small file of zeros could claim any size."""
MAX_LOG_BYTES: Final = 1 << 32
"""Limit of the size of a log: 1,000 times a log of ten minutes."""


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Content of a log; packets are read-only.

    `log["/sensors"]["encoder_count"]` has one row for each message, shape (n, 5). Topics without messages are
    absent.
    """

    path: Path
    header: Mapping[str, str]
    truncated: bool
    """True if the writer died before it closed the log; all complete chunks are here."""
    packets: Mapping[str, NDArray[np.void]]
    """Packets by topic, shape (n,)."""
    time_ns: Mapping[str, NDArray[np.uint64]]
    """Log time of each message by topic, with EVRs and commands, shape (n,)."""
    evrs: tuple[EvrEntry, ...]
    commands: tuple[CommandEntry, ...]
    truth: frozenset[str] = frozenset()
    """Topics of the plant's own state, which flight software never saw."""
    lost: tuple[LostMessages, ...] = ()
    """Losses of a log that was recovered from a damaged one."""
    interrupted_by: str = ""
    """Cause if the run was interrupted; empty if it was not, or if its writer died."""
    trailing_bytes: int = 0
    """Bytes in the file after the end of the log; they are not read."""

    @property
    def end(self) -> Literal["closed", "interrupted", "cut short"]:
        """Return how the log ends; "interrupted" if the run was not completed."""
        if self.truncated:
            return "cut short"
        return "interrupted" if self.interrupted_by else "closed"

    @property
    def end_note(self) -> str:
        """Return a sentence about a log that ends before its run; empty for a closed log."""
        if self.truncated:
            return "it was cut short: its writer did not close it"
        by = self.interrupted_by
        return f"the run was interrupted by {by}; the log ends there" if by else ""

    def __getitem__(self, topic: str) -> NDArray[np.void]:
        if topic not in self.packets:
            raise KeyError(f"log {self.path} has no topic {topic}; it has {', '.join(sorted(self.packets))}")
        return self.packets[topic]

    def ticks(self, topic: str) -> NDArray[np.int64]:
        """Return the tick of each message of a topic, shape (n,)."""
        return (self.time_ns[topic] // TICK_NS).astype(np.int64)


@dataclass(frozen=True, slots=True)
class LogSelection:
    """Selected part of a log: topics, None for all, and log times from `start_ns` to before `end_ns`."""

    topics: Collection[str] | None = None
    start_ns: int = 0
    end_ns: int = 1 << 64

    def is_at(self, time_ns: NDArray[np.uint64]) -> NDArray[np.bool_]:
        """Return whether each message is of the selected time, by log times, (n,)."""
        return (time_ns >= self.start_ns) & (time_ns < self.end_ns)


WHOLE_LOG: Final = LogSelection()


def read_log(
    path: Path | str,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Log:
    """Read a log, closed or truncated.

    Args:
        topics: Topics to read, with /evr and /command; None for all.
        end_ns: Log time before which reading ends; None for the end.

    Raises:
        LogNotReadable: there is no such file, or it is not a marsarm log.
        LogDamaged: a CRC, a length or a sequence shows damage.
    """
    end_ns = WHOLE_LOG.end_ns if end_ns is None else end_ns
    return parse_log(Path(path), read_log_bytes(Path(path)), LogSelection(topics, start_ns or 0, end_ns))


def read_log_bytes(path: Path) -> bytes:
    """Read a file; LogNotReadable if it cannot be read, is no regular file, or is larger than any log."""
    try:
        return read_bytes(path, MAX_LOG_BYTES, "a log, such as run.mcap")
    except RobotError as error:
        raise LogNotReadable(path, str(error).partition(": ")[2]) from error
    except MemoryError as error:
        raise LogNotReadable(path, "does not fit into memory") from error


def parse_log(path: Path, data: bytes, selection: LogSelection = WHOLE_LOG) -> Log:
    """Parse a log from the content of its file; errors as in `read_log`."""
    if not data.startswith(MCAP0_MAGIC):
        raise LogNotReadable(path, NO_MCAP if data else "an empty file; nothing was written to it")
    try:
        found = read_records(data)
        header = checked_header(path, found)
        try:
            log = _build_log(path, found, header, selection)
        except PARSE_ERRORS as error:
            raise CorruptData(str(error) or type(error).__name__, found.end) from error
        if not found.crc_holds:
            raise CorruptData("the data does not match its CRC", found.end)
        return log
    except CorruptData as error:
        raise LogDamaged(path, error.why, error.offset) from error


def checked_header(path: Path, found: McapContent) -> dict[str, str]:
    """Return the header of a log; LogNotReadable if it is none of ours, CorruptData if its CRC is wrong."""
    about, header = found.metadata.get(FORMAT_RECORD), found.metadata.get(HEADER_RECORD)
    if about is None:
        raise LogNotReadable(path, "an MCAP file, but not a marsarm log, or cut short before its header")
    if problem := version_problem(found.metadata):
        raise LogNotReadable(path, problem)
    if header is None:
        raise LogNotReadable(path, "cut short before the end of its header; it holds no cycle")
    if header_crc32(header) != about.get("header_crc32"):
        raise CorruptData("the header does not match its CRC", len(MCAP0_MAGIC))
    return header


def _build_log(path: Path, found: McapContent, header: dict[str, str], selection: LogSelection) -> Log:
    """Build the log of the selected topics; a damaged message raises one of PARSE_ERRORS."""
    # A chunk may be skipped only in a closed log, because only the CRC of all data covers its times.
    chosen = [
        (at, chunk)
        for at, chunk in found.chunks
        if not found.closed
        or (chunk.message_end_time >= selection.start_ns and chunk.message_start_time < selection.end_ns)
    ]
    size = sum(chunk.uncompressed_size for _, chunk in chosen)
    if size > MAX_UNPACKED_BYTES:
        why = f"unpacks to {size / 1e9:.1f} GB, {MAX_UNPACKED_BYTES / 1e9:.1f} GB at most are read at once"
        raise LogNotReadable(path, f"{why}; ask for a part, from one time to another")
    specs = decode_topics(header)
    from_start = not chosen or chosen[0] == found.chunks[0]
    wanted = [one for one in specs if selection.topics is None or one.topic in selection.topics]
    packets, times, bodies = _take_messages(chosen, wanted, selection, from_start)
    return Log(
        path=path,
        header=header,
        truncated=not found.closed,
        packets=packets,
        time_ns=times,
        evrs=tuple(EvrEntry.decode(body) for body in bodies.get(EVR_TOPIC, [])),
        commands=tuple(CommandEntry.decode(body) for body in bodies.get(COMMAND_TOPIC, [])),
        truth=frozenset(one.topic for one in specs if one.is_truth),
        lost=losses_in(found.metadata.get(RECOVERED_RECORD, {})),
        interrupted_by=without_crc(found.metadata.get(END_RECORD, {})).get(INTERRUPTED_KEY, ""),
        trailing_bytes=found.trailing_bytes,
    )


def _take_messages(
    chunks: Sequence[tuple[int, Chunk]], specs: Sequence[TopicSpec], selection: LogSelection, from_start: bool
) -> tuple[dict[str, NDArray[np.void]], dict[str, NDArray[np.uint64]], dict[str, list[bytes]]]:
    """Return packets, times, and messages without a layout, by topic."""
    heads: dict[str, list[NDArray[np.void]]] = {one.topic: [] for one in specs}
    parts: dict[str, list[NDArray[np.uint8]]] = {one.topic: [] for one in specs}
    bodies: dict[str, list[bytes]] = {one.topic: [] for one in specs}
    dtypes = {one.topic: one.layout.dtype for one in specs if one.layout is not None}
    for batch in read_batches(chunks):
        is_selected = selection.is_at(batch.heads["time_ns"])
        for one in specs:
            is_here = batch.heads["channel"] == one.id
            heads[one.topic].append(batch.heads[is_here])
            rows = np.flatnonzero(is_here & is_selected)
            if one.layout is None:
                bodies[one.topic] += batch.bodies(rows)
            else:
                parts[one.topic].append(batch.same_size(rows, dtypes[one.topic].itemsize))
    packets, times = {}, {}
    for one in specs:
        found = np.concatenate([np.zeros(0, MESSAGE_DTYPE), *heads[one.topic]])
        _check_messages(one.topic, found, from_start, one.layout is not None)
        is_selected = selection.is_at(found["time_ns"])
        if is_selected.any():
            times[one.topic] = found["time_ns"][is_selected]
            if one.layout is not None:
                packets[one.topic] = np.concatenate(parts[one.topic]).view(dtypes[one.topic])[:, 0]
                packets[one.topic].flags.writeable = False
    return packets, times, bodies


def _check_messages(topic: str, heads: NDArray[np.void], from_start: bool, one_a_cycle: bool) -> None:
    """Check that sequence numbers are consecutive, from 0 if `from_start`, and that times do not go back.

    Heads are of MESSAGE_DTYPE, (n,); with one message a cycle, times rise strictly. Else it is a ValueError.
    """
    sequence, time_ns = heads["sequence"].astype(np.int64), heads["time_ns"]
    first = 0 if from_start or not len(sequence) else int(sequence[0])
    if not np.array_equal(sequence, np.arange(first, first + len(sequence))):
        raise ValueError(f"messages of {topic} are missing or out of order")
    is_wrong = time_ns[1:] <= time_ns[:-1] if one_a_cycle else time_ns[1:] < time_ns[:-1]
    if is_wrong.any():
        k = int(np.argmax(is_wrong)) + 1
        now_s, before_s = time_ns[k] / 1e9, time_ns[k - 1] / 1e9
        if now_s < before_s:
            raise ValueError(
                f"message {k} of {topic}, at {now_s:.6f} s, comes after one of {before_s:.6f} s; "
                "times must not go back"
            )
        raise ValueError(
            f"messages {k - 1} and {k} of {topic} are both of {now_s:.6f} s; a cycle has one of each"
        )
