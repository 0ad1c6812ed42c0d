"""Reads a log into numpy arrays; what it gives was written, or it says what is wrong."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Final

import numpy as np
from mcap.records import Channel
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from ground.telemetry.chunks import MessageBatch, read_batches
from ground.telemetry.errors import LogNotReadable
from ground.telemetry.events import CommandEntry, EvrEntry
from ground.telemetry.format import CHANNELS_KEY, COMMAND_TOPIC, EVR_TOPIC, HEADER_RECORD, TICK_NS
from ground.telemetry.lost_messages import RECOVERED_RECORD, LogDamaged, LostMessages, losses_in
from ground.telemetry.mcap_reader import (
    MAX_UNPACKED_BYTES,
    PARSE_ERRORS,
    ChunkLocation,
    CorruptData,
    McapContent,
    read_records,
)
from ground.telemetry.salvage import has_intact_chunk, salvage
from ground.telemetry.topic_arrays import (
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
"""Of a file that is read at all: 1,000 times a log of ten minutes."""


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What a log holds; packets are read-only.

    `log["/sensors"]["encoder_count"]` has one row a message, shape (n, 5). A topic that got no message is not
    there. A log cut short by the death of its writer is `truncated`: it holds all chunks that were complete.
    """

    path: Path
    header: Mapping[str, str]
    truncated: bool
    packets: Mapping[str, NDArray[np.void]]
    time_ns: Mapping[str, NDArray[np.uint64]]
    """Log time of each message, shape (n,), by topic; EVRs and commands included."""
    evrs: tuple[EvrEntry, ...]
    commands: tuple[CommandEntry, ...]
    truth: frozenset[str] = frozenset()
    """Topics of the plant's own state, which flight software never saw."""
    lost: tuple[LostMessages, ...] = ()
    """In a log that was recovered from a damaged one: what could not be saved."""
    behind: int = 0
    """Bytes in the file behind the end of the log, which were not read."""

    def __getitem__(self, topic: str) -> NDArray[np.void]:
        if topic not in self.packets:
            raise KeyError(f"log {self.path} has no topic {topic}; it has {', '.join(sorted(self.packets))}")
        return self.packets[topic]

    def ticks(self, topic: str) -> NDArray[np.int64]:
        """The cycle of each message of a topic, shape (n,)."""
        return (self.time_ns[topic] // TICK_NS).astype(np.int64)


@dataclass(frozen=True, slots=True)
class LogSelection:
    """What is asked of a log: topics, None for all; log times from `start_ns` to before `end_ns`."""

    topics: frozenset[str] | None
    start_ns: int
    end_ns: int | None

    def has_topic(self, topic: str) -> bool:
        """Whether a topic is asked for."""
        return self.topics is None or topic in self.topics

    def overlaps(self, chunk: ChunkLocation) -> bool:
        """Whether a chunk may hold something from the time asked for."""
        return chunk.last_ns >= self.start_ns and (self.end_ns is None or chunk.first_ns < self.end_ns)

    def is_at(self, time_ns: NDArray[np.uint64]) -> NDArray[np.bool_]:
        """Which messages are of the time asked for, shape (n,)."""
        begun = time_ns >= self.start_ns
        return begun if self.end_ns is None else begun & (time_ns < self.end_ns)


def read_log(
    path: Path | str,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Log:
    """Read a log, whole or cut short; all of it, or these topics from `start_ns` to before `end_ns`.

    EVRs and commands are topics too: /evr and /command.

    Raises:
        LogNotReadable: there is no such file, or it is not a log of ours.
        LogDamaged: a CRC, a length or a sequence shows that bytes are not as written; it says what is lost.
    """
    path = Path(path)
    wanted = LogSelection(None if topics is None else frozenset(topics), max(start_ns or 0, 0), end_ns)
    return parse_log(path, read_log_bytes(path), wanted)


def read_log_bytes(path: Path) -> bytes:
    """A file's content; LogNotReadable where there is none, or more than any log has."""
    try:
        about = path.stat()
        # A pipe would be waited for, and a device may have no end.
        if not S_ISREG(about.st_mode):
            raise LogNotReadable(path, "is not a regular file; give the path of a log, such as run.mcap")
        if about.st_size > MAX_LOG_BYTES:
            raise LogNotReadable(path, f"has {about.st_size} bytes; a log has at most {MAX_LOG_BYTES}")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise LogNotReadable(path, f"cannot be read ({error}); give the path of a log") from error
    except MemoryError as error:
        raise LogNotReadable(path, f"its {about.st_size} bytes do not fit into memory") from error


WHOLE_LOG = LogSelection(None, 0, None)


def parse_log(path: Path, data: bytes, wanted: LogSelection = WHOLE_LOG) -> Log:
    """Read a log from a file's content; errors as of `read_log`."""
    if not data.startswith(MCAP0_MAGIC):
        raise LogNotReadable(path, NO_MCAP if data else "an empty file; nothing was written to it")
    try:
        return _parse_checked(path, data, wanted)
    except CorruptData as error:
        found = salvage(data)
        why = "; ".join((error.why, *found.notes))
        raise LogDamaged(path, why, error.offset, found.lost) from error


def _parse_checked(path: Path, data: bytes, wanted: LogSelection) -> Log:
    found = read_records(path, data)
    if not found.complete and has_intact_chunk(data, found.data_end):
        raise CorruptData("a record is broken", found.data_end)
    chosen = _select_chunks(found, wanted)
    _check_room(path, sum(found.chunks[k].size for k in chosen))
    batches = read_batches(data, [found.chunks[k] for k in chosen], [found.indexes[k] for k in chosen])
    if not found.crc_holds:  # said after the chunks, which say better where
        raise CorruptData("the data does not match its CRC", found.data_end)
    try:
        return _build_log(path, found, batches, wanted, not chosen or chosen[0] == 0)
    except PARSE_ERRORS as error:
        raise CorruptData(str(error), found.data_end) from error


def _check_room(path: Path, size: int) -> None:
    if size > MAX_UNPACKED_BYTES:
        why = f"unpacks to {size / 1e9:.1f} GB, {MAX_UNPACKED_BYTES / 1e9:.1f} GB at most are read at once"
        raise LogNotReadable(path, f"{why}; ask for a part, from one time to another")


def _select_chunks(found: McapContent, wanted: LogSelection) -> list[int]:
    """The chunks to unpack.

    What a chunk says of its times is covered by the CRC of a closed log alone, and its channels may be
    declared in a chunk that is not unpacked: where this cannot be told, all chunks are.
    """
    can_skip = found.closed and CHANNELS_KEY in found.metadata[HEADER_RECORD]
    return [k for k, chunk in enumerate(found.chunks) if not can_skip or wanted.overlaps(chunk)]


def _build_log(
    path: Path, found: McapContent, batches: Sequence[MessageBatch], wanted: LogSelection, from_start: bool
) -> Log:
    """All topics that are asked for; one of NOT_AS_WRITTEN when a message is not as it should be."""
    header = found.metadata[HEADER_RECORD]
    channels = _find_topics(header, batches)
    packets, times, bodies = {}, {}, dict[str, list[bytes]]()
    for number, channel in channels.items():
        topic, layout = channel.topic, channel.layout
        if not wanted.has_topic(topic):
            continue
        rows = rows_of(batches, number)
        heads = heads_of(batches, rows)
        check_complete(topic, heads, from_start)
        check_order(topic, heads["time_ns"], layout is not None)
        is_asked = wanted.is_at(heads["time_ns"])
        if not is_asked.any():
            continue
        if not is_asked.all():
            rows = select_rows(rows, is_asked)
        times[topic] = heads["time_ns"][is_asked]
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
        evrs=tuple(map(EvrEntry.decode, bodies.get(EVR_TOPIC, []))),
        commands=tuple(map(CommandEntry.decode, bodies.get(COMMAND_TOPIC, []))),
        truth=frozenset(channel.topic for channel in channels.values() if channel.is_truth),
        lost=losses_in(found.metadata.get(RECOVERED_RECORD, {})),
        behind=found.behind if found.closed else 0,
    )


def _find_topics(header: Mapping[str, str], batches: Sequence[MessageBatch]) -> dict[int, KnownTopic]:
    """The channels of ours; ValueError where a message's channel is nowhere declared."""
    records: dict[int, Channel] = {}
    for batch in batches:
        records |= batch.channels
    used = set().union(*(np.unique(batch.heads["channel"]).tolist() for batch in batches))
    if CHANNELS_KEY not in header and not used <= set(records):
        raise ValueError(f"messages of channels {sorted(used - set(records))}, which were never declared")
    return known_topics(header, records)
