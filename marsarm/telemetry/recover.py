"""Recovery: copies all readable messages of a damaged log to a new, complete log, and says what is lost."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from marsarm.telemetry.format import (
    END_RECORD,
    FORMAT_RECORD,
    HEADER_RECORD,
    INTERRUPTED_KEY,
    RECOVERED_RECORD,
    LogNotReadable,
    LostMessages,
    end_metadata,
    header_crc32,
    loss_metadata,
    losses_in,
    trailing_bytes_text,
    version_problem,
    without_crc,
)
from marsarm.telemetry.log_writer import MESSAGE_HEADER, RECORD_HEAD
from marsarm.telemetry.mcap_columns import CHUNK_MARK, MARK_PLACE, PARSE_ERRORS, message_starts, unpack_chunk
from marsarm.telemetry.read import MAX_UNPACKED_BYTES, parse_log, read_log_bytes
from marsarm.telemetry.topics import TopicSpec, begin_log, decode_topics, spec_of_channel
from simgap.common.files import atomic_write, check_distinct_files, check_output
from simgap.common.progress import Progress

NOTHING: Final = "holds no undamaged message, only a header at most; nothing can be saved"
PROGRESS_EVERY: Final = 1000
"""Messages between two reports of the progress."""


class Message(NamedTuple):
    """Message of a channel; its number counts those of the channel."""

    channel: int
    number: int
    time_ns: int
    body: bytes


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
    if not specs:
        raise LogNotReadable(bad, "nothing in it says what its messages mean; nothing can be saved")
    found, duplicates = _messages([plain for _, _, plain in chunks])
    if not found:
        raise LogNotReadable(bad, NOTHING)
    if duplicates:
        notes.append(f"{duplicates} duplicate messages left out")
    is_end_known = _reaches_end(data, chunks[-1][1])
    try:
        earlier = losses_in(metadata.get(RECOVERED_RECORD, {}))
    except PARSE_ERRORS:
        earlier = (LostMessages(None, None, None, None),)
    lost = (*earlier, *find_losses(found, specs, is_end_known))
    with atomic_write(good, "GOOD") as file:
        saved = _write(file, metadata, specs, lost, found, progress)
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
    """Return the channels, from the header or, if it is lost, from the chunks."""
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
        specs = (spec_of_channel(one, schemas[one.schema_id]) for _, one in sorted(channels.items()))
        return tuple(one for one in specs if one.is_flight)
    except PARSE_ERRORS:
        return ()


def _messages(plains: Sequence[bytes]) -> tuple[list[Message], int]:
    """Return all messages that are new, which have a number above all before, and how many are not."""
    found, last, total = list[Message](), Counter[int](), 0
    for plain in plains:
        for start in message_starts(plain):
            _, length, channel, number, time_ns, _ = MESSAGE_HEADER.unpack_from(plain, start)
            body = plain[start + MESSAGE_HEADER.size : start + RECORD_HEAD.size + length]
            total += 1
            if number >= last[channel]:
                found.append(Message(channel, number, time_ns, body))
                last[channel] = number + 1
    return found, total - len(found)


def find_losses(
    messages: Sequence[Message], specs: Sequence[TopicSpec], is_end_known: bool
) -> tuple[LostMessages, ...]:
    """Find breaks in the sequence numbers of channels, and what may be missing without such a break.

    There is at least one message. Without a known end, what follows the last one may be missing.
    """
    lost = list[LostMessages]()
    names = {one.id: one.topic for one in specs}
    last_ns: dict[str, int | None] = dict.fromkeys(names.values())
    following = Counter[str]()
    for one in messages:
        if one.channel in names:
            topic = names[one.channel]
            if one.number > following[topic]:
                missing = one.number - following[topic]
                lost.append(LostMessages(topic, missing, last_ns[topic], one.time_ns))
            following[topic], last_ns[topic] = one.number + 1, one.time_ns
    # A break after the last message of a channel may have cost any number of its messages.
    for topic, time_ns in last_ns.items():
        end_ns = -1 if time_ns is None else time_ns
        later = [gap for gap in lost if gap.count is not None and end_ns < (gap.before_ns or 0)]
        if later:
            after_ns = min((gap.after_ns for gap in later if gap.after_ns is not None), default=None)
            lost.append(LostMessages(topic, None, after_ns, max(gap.before_ns or 0 for gap in later)))
    if not is_end_known:
        lost.append(LostMessages(None, None, max(one.time_ns for one in messages), None))
    order = [*names.values(), None]
    return tuple(sorted(lost, key=lambda one: (one.count is None, order.index(one.topic))))


def _write(
    file: BinaryIO,
    metadata: Mapping[str, Mapping[str, str]],
    specs: Sequence[TopicSpec],
    lost: Sequence[LostMessages],
    messages: Sequence[Message],
    progress: Progress,
) -> dict[str, int]:
    """Write the messages of known channels, renumbered, and return their number by topic."""
    renumbered = {one.id: replace(one, id=number) for number, one in enumerate(specs, 1)}
    header = metadata.get(HEADER_RECORD, {})
    writer = begin_log(file, header, tuple(renumbered.values()), [loss_metadata(lost)])
    saved = Counter[str]()
    for k, one in enumerate(messages):
        if one.channel in renumbered:
            spec = renumbered[one.channel]
            writer.add(one.time_ns, [(spec.id, one.body)])
            saved[spec.topic] += 1
        if k % PROGRESS_EVERY == 0:
            progress(k, len(messages), "writing")
    try:
        interrupted_by = without_crc(metadata.get(END_RECORD, {})).get(INTERRUPTED_KEY, "")
    except ValueError:
        interrupted_by = ""
    writer.finish(end_metadata(interrupted_by))
    return saved
