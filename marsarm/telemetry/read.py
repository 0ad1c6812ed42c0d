"""Strict reader of logs into numpy arrays: it returns what was written, or reports the damage."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Final, Literal

import numpy as np
from mcap.records import Channel
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from marsarm.telemetry.chunks import MessageBatch, read_batches
from marsarm.telemetry.errors import LogNotReadable
from marsarm.telemetry.events import CommandEntry, EvrEntry
from marsarm.telemetry.format import (
    CHANNELS_KEY,
    COMMAND_TOPIC,
    END_RECORD,
    EVR_TOPIC,
    HEADER_RECORD,
    TICK_NS,
    interruption_in,
)
from marsarm.telemetry.lost_messages import (
    RECOVERED_RECORD,
    LogDamaged,
    LostMessages,
    interruption_text,
    losses_in,
)
from marsarm.telemetry.mcap_reader import (
    MAX_UNPACKED_BYTES,
    PARSE_ERRORS,
    ChunkLocation,
    CorruptData,
    McapContent,
    read_records,
)
from marsarm.telemetry.salvage import has_intact_chunk, salvage
from marsarm.telemetry.topic_arrays import (
    KnownTopic,
    bodies_of,
    check_complete,
    check_order,
    heads_of,
    known_topics,
    packets_of,
    rows_of,
    select_rows,
)

NO_MCAP: Final = (
    "not an MCAP file; `marsarm run --log run.mcap` writes one, `marsarm log import` makes one of a table"
)

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
        return interruption_text(self.interrupted_by) if self.interrupted_by else ""

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

    topics: frozenset[str] | None
    start_ns: int
    end_ns: int | None

    def has_topic(self, topic: str) -> bool:
        """Return whether a topic is selected."""
        return self.topics is None or topic in self.topics

    def overlaps(self, chunk: ChunkLocation) -> bool:
        """Return whether a chunk may have messages of the selected time."""
        return chunk.last_ns >= self.start_ns and (self.end_ns is None or chunk.first_ns < self.end_ns)

    def is_at(self, time_ns: NDArray[np.uint64]) -> NDArray[np.bool_]:
        """Return whether each message is of the selected time.

        Args:
            time_ns: Log times, shape (n,).

        Returns:
            Flags, shape (n,).
        """
        is_after_start = time_ns >= self.start_ns
        return is_after_start if self.end_ns is None else is_after_start & (time_ns < self.end_ns)


def read_log(
    path: Path | str,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Log:
    """Read a log, closed or truncated.

    Args:
        path: File.
        topics: Topics to read, with /evr and /command; None for all.
        start_ns: First log time; None for the beginning.
        end_ns: Log time before which reading ends; None for the end.

    Raises:
        LogNotReadable: there is no such file, or it is not a marsarm log.
        LogDamaged: a CRC, a length or a sequence shows damage; the error lists the losses.
    """
    path = Path(path)
    selection = LogSelection(None if topics is None else frozenset(topics), max(start_ns or 0, 0), end_ns)
    return parse_log(path, read_log_bytes(path), selection)


def read_log_bytes(path: Path) -> bytes:
    """Read the content of a file.

    Raises:
        LogNotReadable: it cannot be read, is no regular file, or is larger than any log.
    """
    try:
        about = path.stat()
        # Reading a pipe would block, and a device may have no end.
        if not S_ISREG(about.st_mode):
            raise LogNotReadable(path, "is not a regular file; give the path of a log, such as run.mcap")
        if about.st_size > MAX_LOG_BYTES:
            raise LogNotReadable(path, f"has {about.st_size} bytes; a log has at most {MAX_LOG_BYTES}")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise LogNotReadable(path, f"cannot be read ({why}); give the path of a log") from error
    except MemoryError as error:
        raise LogNotReadable(path, f"its {about.st_size} bytes do not fit into memory") from error


WHOLE_LOG = LogSelection(None, 0, None)


def parse_log(path: Path, data: bytes, selection: LogSelection = WHOLE_LOG) -> Log:
    """Parse a log from the content of its file; errors as in `read_log`."""
    if not data.startswith(MCAP0_MAGIC):
        raise LogNotReadable(path, NO_MCAP if data else "an empty file; nothing was written to it")
    try:
        return _parse_checked(path, data, selection)
    except CorruptData as error:
        found = salvage(data)
        why = "; ".join((error.why, *found.notes))
        raise LogDamaged(path, why, error.offset, found.lost) from error


def _parse_checked(path: Path, data: bytes, selection: LogSelection) -> Log:
    found = read_records(path, data)
    if not found.complete and has_intact_chunk(data, found.data_end):
        raise CorruptData("a record is broken", found.data_end)
    chosen = _select_chunks(found, selection)
    _check_room(path, sum(found.chunks[k].size for k in chosen))
    batches = read_batches(data, [found.chunks[k] for k in chosen], [found.indexes[k] for k in chosen])
    if not found.crc_holds:  # checked after the chunks, whose errors name a more exact place
        raise CorruptData("the data does not match its CRC", found.data_end)
    try:
        return _build_log(path, found, batches, selection, not chosen or chosen[0] == 0)
    except PARSE_ERRORS as error:
        raise CorruptData(str(error), found.data_end) from error


def _check_room(path: Path, size: int) -> None:
    if size > MAX_UNPACKED_BYTES:
        why = f"unpacks to {size / 1e9:.1f} GB, {MAX_UNPACKED_BYTES / 1e9:.1f} GB at most are read at once"
        raise LogNotReadable(path, f"{why}; ask for a part, from one time to another")


def _select_chunks(found: McapContent, selection: LogSelection) -> list[int]:
    """Return the chunks to decompress.

    Chunks can be skipped only if two conditions hold. The log is closed: only its CRC covers the times of a
    chunk. The header lists the channels: else a skipped chunk might declare them.
    """
    can_skip = found.closed and CHANNELS_KEY in found.metadata[HEADER_RECORD]
    return [k for k, chunk in enumerate(found.chunks) if not can_skip or selection.overlaps(chunk)]


def _build_log(
    path: Path, found: McapContent, batches: Sequence[MessageBatch], selection: LogSelection, from_start: bool
) -> Log:
    """Build the log of the selected topics; a damaged message raises one of PARSE_ERRORS."""
    header = found.metadata[HEADER_RECORD]
    channels = _find_topics(header, batches)
    packets, times, bodies = {}, {}, dict[str, list[bytes]]()
    for number, channel in channels.items():
        topic, layout = channel.topic, channel.layout
        if not selection.has_topic(topic):
            continue
        rows = rows_of(batches, number)
        heads = heads_of(batches, rows)
        check_complete(topic, heads, from_start)
        check_order(topic, heads["time_ns"], layout is not None)
        is_selected = selection.is_at(heads["time_ns"])
        if not is_selected.any():
            continue
        if not is_selected.all():
            rows = select_rows(rows, is_selected)
        times[topic] = heads["time_ns"][is_selected]
        if layout is None:
            bodies[topic] = bodies_of(batches, rows)
        else:
            packets[topic] = packets_of(batches, rows, topic, layout)
    return Log(
        path=path,
        header=header,
        truncated=not found.closed,
        packets=packets,
        time_ns=times,
        evrs=tuple(EvrEntry.decode(body) for body in bodies.get(EVR_TOPIC, [])),
        commands=tuple(CommandEntry.decode(body) for body in bodies.get(COMMAND_TOPIC, [])),
        truth=frozenset(channel.topic for channel in channels.values() if channel.is_truth),
        lost=losses_in(found.metadata.get(RECOVERED_RECORD, {})),
        interrupted_by=interruption_in(found.metadata.get(END_RECORD, {})),
        trailing_bytes=found.trailing_bytes if found.closed else 0,
    )


def _find_topics(header: Mapping[str, str], batches: Sequence[MessageBatch]) -> dict[int, KnownTopic]:
    """Return the flight channels by number.

    Raises:
        ValueError: a message has a channel that is declared nowhere.
    """
    records: dict[int, Channel] = {}
    for batch in batches:
        records |= batch.channels
    used = set().union(*(np.unique(batch.heads["channel"]).tolist() for batch in batches))
    if CHANNELS_KEY not in header and not used <= set(records):
        raise ValueError(f"messages of channels {sorted(used - set(records))}, which were never declared")
    return known_topics(header, records)
