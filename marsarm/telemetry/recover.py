"""Recovery: copies all readable messages of a damaged log to a new, complete log, and says what is lost."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from marsarm.telemetry.errors import (
    RECOVERED_RECORD,
    LogNotReadable,
    LostMessages,
    loss_metadata,
    losses_in,
    trailing_bytes_text,
)
from marsarm.telemetry.format import (
    CHUNK_CYCLES,
    END_RECORD,
    FORMAT_RECORD,
    HEADER_RECORD,
    TICK_NS,
    end_metadata,
    header_crc32,
    interruption_in,
    version_problem,
)
from marsarm.telemetry.log_writer import RECORD_HEAD
from marsarm.telemetry.mcap_columns import (
    CHUNK_MARK,
    MARK_PLACE,
    PARSE_ERRORS,
    MessageBatch,
    make_batch,
    message_starts,
    unpack_chunk,
)
from marsarm.telemetry.read import MAX_UNPACKED_BYTES, parse_log, read_log_bytes
from marsarm.telemetry.topics import TopicSpec, begin_log, decode_topics, spec_of_channel
from simgap.common.files import atomic_write, check_distinct_files, check_output
from simgap.common.progress import Progress

NOTHING: Final = "holds no undamaged message, only a header at most; nothing can be saved"
CHUNK_NS: Final = CHUNK_CYCLES * TICK_NS


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """Result of a recovery."""

    saved: Mapping[str, int]
    """Number of saved messages by topic."""
    lost: tuple[LostMessages, ...]
    """Losses of this recovery and of earlier ones."""
    header_lost: bool
    """True if versions, parameters and commands of the run are lost."""
    notes: tuple[str, ...] = ()
    """Sentences about parts of the file that were left out."""


def recover(bad: Path, good: Path, progress: Progress) -> RecoveryReport:
    """Write the readable messages of one log to another.

    Messages are renumbered, so the new log is complete in itself. Metadata in it lists the losses. The new
    file appears only after it was read back without an error.

    Args:
        bad: Damaged log.
        good: New file.
        progress: Called for each chunk.

    Raises:
        LogNotReadable: `bad` cannot be read, or has no part of a marsarm log.
        LogDamaged: the readable parts do not form a log.
        BadOutput: `good` cannot be written.
        BadRequest: `good` and `bad` are the same file.
    """
    data = read_log_bytes(bad)
    check_distinct_files({"BAD": bad, "GOOD": check_output(good, (".mcap",), "GOOD")})
    progress(0, 1, "searching")
    end = data.find(MCAP0_MAGIC, len(MCAP0_MAGIC)) + len(MCAP0_MAGIC)
    rest = len(data) - end if end >= len(MCAP0_MAGIC) else 0
    data = data[: len(data) - rest]  # every run numbers its messages from 0, so two must not be mixed
    notes = [trailing_bytes_text(rest)] if rest else []
    metadata = _find_metadata(data)
    chunks = list(_intact_chunks(data, notes))
    if problem := version_problem(metadata):
        raise LogNotReadable(bad, problem)
    if not chunks:
        raise LogNotReadable(bad, NOTHING)
    specs = _find_specs(metadata.get(HEADER_RECORD, {}), chunks)
    if not any(one.is_flight for one in specs):
        raise LogNotReadable(bad, "nothing in it says what its messages mean; nothing can be saved")
    batch, is_new = _join_chunks([plain for _, _, plain in chunks])
    if not is_new.any():
        raise LogNotReadable(bad, NOTHING)
    if not is_new.all():
        notes.append(f"{np.count_nonzero(~is_new)} duplicate messages left out")
    is_end_known = _reaches_end(data, chunks[-1][1])
    lost = (*_earlier_losses(metadata), *find_losses(batch.heads[is_new], specs, is_end_known))
    with atomic_write(good, "GOOD") as file:
        saved = _write(file, metadata, specs, lost, batch, is_new, progress)
        file.flush()
        parse_log(bad, Path(file.name).read_bytes())
    return RecoveryReport(saved, lost, HEADER_RECORD not in metadata, tuple(notes))


def _find_metadata(data: bytes) -> dict[str, dict[str, str]]:
    """Find format, header, recovery and end records anywhere in a file; a header only if its CRC matches."""
    found = {}
    for name in (FORMAT_RECORD, HEADER_RECORD, RECOVERED_RECORD, END_RECORD):
        at = data.find(len(name).to_bytes(4, "little") + name.encode())
        if at < RECORD_HEAD.size:
            continue
        try:
            found[name] = Metadata.read(ReadDataStream(BytesIO(data[at:]))).metadata
        except PARSE_ERRORS:
            continue
    expected = found.get(FORMAT_RECORD, {}).get("header_crc32")
    if HEADER_RECORD in found and header_crc32(found[HEADER_RECORD]) != expected:
        del found[HEADER_RECORD]
    return found


def _intact_chunks(data: bytes, notes: list[str]) -> Iterator[tuple[Chunk, int, bytes]]:
    """Yield each chunk whose CRC matches, the byte behind it, and its records; the rest may be damaged."""
    at, size = data.find(CHUNK_MARK), 0
    while at >= 0:
        begin = at - MARK_PLACE + RECORD_HEAD.size
        next_at = data.find(CHUNK_MARK, at + 1)
        try:
            stream = ReadDataStream(BytesIO(data[begin : next_at if next_at >= 0 else None]))
            chunk = Chunk.read(stream)
            plain = unpack_chunk(chunk)
            message_starts(plain)
        except PARSE_ERRORS:
            pass
        else:
            size += len(plain)
            if size > MAX_UNPACKED_BYTES:
                notes.append(
                    f"it unpacks to more than {MAX_UNPACKED_BYTES / 1e9:.1f} GB; the rest was left out"
                )
                return
            yield chunk, begin + stream.count, plain
        at = next_at


def _reaches_end(data: bytes, at: int) -> bool:
    """Return whether only indexes and metadata are between byte `at` and the end of the data."""
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        if opcode not in (Opcode.MESSAGE_INDEX, Opcode.METADATA):
            return bool(opcode == Opcode.DATA_END)
        at += RECORD_HEAD.size + length
    return False


def _find_specs(
    header: Mapping[str, str], chunks: Sequence[tuple[Chunk, int, bytes]]
) -> tuple[TopicSpec, ...]:
    """Return the channels from the header; if it is lost, from the records in the chunks."""
    try:
        if header:
            return decode_topics(header)
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for chunk, _, plain in chunks:
            if plain[0] == Opcode.SCHEMA:
                for record in breakup_chunk(chunk):
                    if isinstance(record, Schema):
                        schemas[record.id] = record
                    if isinstance(record, Channel):
                        channels[record.id] = record
        return tuple(spec_of_channel(one, schemas[one.schema_id]) for _, one in sorted(channels.items()))
    except PARSE_ERRORS:
        return ()


def _join_chunks(plains: Sequence[bytes]) -> tuple[MessageBatch, NDArray[np.bool_]]:
    """Return all messages, and whether each is new: its number is above all before it, in its channel."""
    starts = list[int]()
    size = 0
    for plain in plains:
        starts += [size + start for start in message_starts(plain)]
        size += len(plain)
    batch = make_batch(b"".join(plains), starts)
    is_new = np.ones(len(starts), np.bool_)
    for channel in np.unique(batch.heads["channel"]):
        rows = np.flatnonzero(batch.heads["channel"] == channel)
        sequence = batch.heads["sequence"][rows].astype(np.int64)
        is_new[rows] = sequence > np.maximum.accumulate(np.append(-1, sequence[:-1]))
    return batch, is_new


def find_losses(
    heads: NDArray[np.void], specs: Sequence[TopicSpec], is_end_known: bool
) -> tuple[LostMessages, ...]:
    """Find breaks in the sequence numbers of channels, and what may be missing without such a break.

    There is at least one message. Without a known end, what follows the last one may be missing.
    """
    lost = list[LostMessages]()
    last_ns = dict[str, int]()
    for one in specs:
        of_topic = heads[heads["channel"] == one.id]
        times_ns = [None, *map(int, of_topic["time_ns"])]
        steps = np.diff(of_topic["sequence"].astype(np.int64), prepend=-1)
        for k in np.flatnonzero(steps > 1).tolist():
            lost.append(LostMessages(one.topic, int(steps[k]) - 1, times_ns[k], times_ns[k + 1]))
        last_ns[one.topic] = times_ns[-1] or 0 if len(of_topic) else -1
    # A break after the last message of a channel may have cost any number of its messages.
    for topic, time_ns in last_ns.items():
        later = [gap for gap in lost if gap.count is not None and time_ns < (gap.before_ns or 0)]
        if later:
            after_ns = min((gap.after_ns for gap in later if gap.after_ns is not None), default=None)
            lost.append(LostMessages(topic, None, after_ns, max(gap.before_ns or 0 for gap in later)))
    if not is_end_known:
        lost.append(LostMessages(None, None, int(heads["time_ns"].max()), None))
    return tuple(lost)


def _earlier_losses(metadata: Mapping[str, Mapping[str, str]]) -> tuple[LostMessages, ...]:
    """Return the losses that earlier recoveries reported."""
    try:
        return losses_in(metadata.get(RECOVERED_RECORD, {}))
    except PARSE_ERRORS:
        return (LostMessages(None, None, None, None),)


def _write(
    file: BinaryIO,
    metadata: Mapping[str, Mapping[str, str]],
    specs: Sequence[TopicSpec],
    lost: Sequence[LostMessages],
    batch: MessageBatch,
    is_new: NDArray[np.bool_],
    progress: Progress,
) -> dict[str, int]:
    """Write the new messages of known channels, renumbered, and return their number by topic."""
    renumbered = {one.id: replace(one, id=number) for number, one in enumerate(specs, 1)}
    lost_record = Metadata(RECOVERED_RECORD, loss_metadata(lost))
    header = metadata.get(HEADER_RECORD, {})
    writer = begin_log(file, header, tuple(renumbered.values()), [lost_record])
    rows = np.flatnonzero(is_new & np.isin(batch.heads["channel"], list(renumbered)))
    counts, chunk = Counter[int](), 0
    for k, (head, body) in enumerate(zip(batch.heads[rows].tolist(), batch.bodies(rows), strict=True)):
        _, _, channel, _, time_ns, publish_ns = head
        writer.add_message(renumbered[channel].id, time_ns, body, publish_ns, counts[channel])
        counts[channel] += 1
        if time_ns // CHUNK_NS != chunk:
            chunk = time_ns // CHUNK_NS
            writer.flush()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself
            progress(k, len(rows), "writing")
    for record in end_metadata(_interruption(metadata)):
        writer.add_metadata(record.name, record.metadata)
    writer.finish()  # type: ignore[no-untyped-call]
    return {renumbered[channel].topic: count for channel, count in counts.items()}


def _interruption(metadata: Mapping[str, Mapping[str, str]]) -> str:
    try:
        return interruption_in(metadata.get(END_RECORD, {}))
    except ValueError:
        return ""
