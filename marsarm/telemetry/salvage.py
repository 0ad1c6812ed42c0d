"""Search of a damaged log for intact chunks, and the messages that are missing between them."""

import zlib
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from io import BytesIO
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from marsarm.telemetry.chunks import MESSAGE_DTYPE, MESSAGE_OVERHEAD, heads_at, walk_records
from marsarm.telemetry.events import CommandEntry, EvrEntry, LogEntry
from marsarm.telemetry.format import (
    COMMAND_TOPIC,
    END_RECORD,
    EVR_TOPIC,
    FORMAT_RECORD,
    HEADER_RECORD,
    LAYOUT_KEY,
    TRUTH_KEY,
    TRUTH_TEXT,
    header_crc32,
    interruption_in,
)
from marsarm.telemetry.lost_messages import RECOVERED_RECORD, LostMessages, losses_in, trailing_bytes_text
from marsarm.telemetry.mcap_reader import (
    CHUNK_HEAD,
    MAX_CHUNK_BYTES,
    MAX_UNPACKED_BYTES,
    PARSE_ERRORS,
    RECORD_HEAD,
    compute_crc32,
    find_log_end,
    iter_records,
    parse_channel,
    read_summary,
)
from marsarm.telemetry.schema import ros_definition
from marsarm.telemetry.topic_arrays import KnownTopic, decode_topics, known_topics


@dataclass(frozen=True, slots=True, eq=False)
class IntactChunk:
    """Chunk whose CRC matches."""

    plain: bytes
    """Decompressed records."""
    starts: list[int]
    """Byte in `plain` where each message begins."""
    heads: NDArray[np.void]
    """Heads of the messages, type MESSAGE_DTYPE, shape (n,)."""

    def messages(self) -> Iterator[tuple[int, int, int, int, bytes]]:
        """Yield channel, sequence, log time, publish time and body of each message."""
        for start, head in zip(self.starts, self.heads.tolist(), strict=True):
            _, length, *rest = head
            begin = start + MESSAGE_DTYPE.itemsize
            yield (*rest, self.plain[begin : begin + length - MESSAGE_OVERHEAD])


@dataclass(frozen=True, slots=True)
class MissingRange:
    """Missing messages of a channel; they were between the chunks `after` and `before`."""

    channel: int
    count: int
    after: int
    before: int


def find_missing(
    chunks: Sequence[IntactChunk], numbers: Set[int], totals: Mapping[int, int]
) -> list[MissingRange]:
    """Find breaks in the sequence numbers of channels.

    Args:
        chunks: Intact chunks in order.
        numbers: Channels to check, in addition to those with messages.
        totals: Messages that each channel had; they show how many are missing at the end.
    """
    heads = np.concatenate([np.zeros(0, MESSAGE_DTYPE), *(chunk.heads for chunk in chunks)])
    of_chunk = np.repeat(np.arange(len(chunks)), [len(chunk.heads) for chunk in chunks])
    missing = []
    for number in sorted(numbers | set(heads["channel"].tolist())):
        rows = np.flatnonzero(heads["channel"] == number)
        counted = heads["sequence"][rows].astype(np.int64)
        before = np.append(-1, counted)
        for k in np.flatnonzero(np.diff(before) > 1):
            missing.append(
                MissingRange(
                    channel=number,
                    count=int(counted[k] - before[k] - 1),
                    after=-1 if k == 0 else int(of_chunk[rows[k - 1]]),
                    before=int(of_chunk[rows[k]]),
                )
            )
        count = totals.get(number, 0) - int(before[-1]) - 1
        if count > 0:
            last = int(of_chunk[rows[-1]]) if len(rows) else -1
            missing.append(MissingRange(number, count, last, len(chunks)))
    return missing


def find_losses(
    chunks: Sequence[IntactChunk],
    names: Mapping[int, str],
    known: Set[int],
    totals: Mapping[int, int] | None,
    is_complete: bool,
) -> tuple[LostMessages, ...]:
    """Find the messages that are missing before, between and after chunks.

    Args:
        chunks: Intact chunks in order.
        names: Topics by channel.
        known: Channels with a known layout; messages of others cannot be decoded and count as lost.
        totals: Messages that each channel had; None if the summary is lost.
        is_complete: Whether the end of the log is known; if not, an unknown number may be missing there.
    """
    chunks = [chunk for chunk in chunks if len(chunk.heads)]
    heads = np.concatenate([np.zeros(0, MESSAGE_DTYPE), *(chunk.heads for chunk in chunks)])
    missing = find_missing(chunks, known, totals or {})
    # A channel with messages in every chunk shows between which chunks some are missing; a rare one does not.
    breaks = sorted({one.after for one in missing if one.before == one.after + 1})
    ends = [int(chunk.heads["time_ns"].max()) for chunk in chunks]
    begins = [int(chunk.heads["time_ns"].min()) for chunk in chunks]

    def lost_at(number: int, count: int | None, first: int, last: int) -> LostMessages:
        """Return the loss after chunk `first` and before the chunk that follows `last`."""
        after_ns = ends[first] if first >= 0 else None
        before_ns = begins[last + 1] if last + 1 < len(chunks) else None
        return LostMessages(names.get(number, f"channel {number}"), count, after_ns, before_ns)

    lost = []
    for one in missing:
        inside = [chunk for chunk in breaks if one.after <= chunk < one.before] or [one.after, one.before - 1]
        lost.append(lost_at(one.channel, one.count, inside[0], inside[-1]))
    for number in sorted(known) if totals is None else ():
        # A break after the last message of a channel may have cost any number of its messages.
        present = [k for k, chunk in enumerate(chunks) if (chunk.heads["channel"] == number).any()]
        later = [chunk for chunk in breaks if chunk >= max(present, default=-1)]
        if later:
            lost.append(lost_at(number, None, later[0], later[-1]))
    for number in sorted(set(heads["channel"].tolist()) - known):
        count = int((heads["channel"] == number).sum())
        lost.append(LostMessages(names.get(number, f"channel {number}"), count, None, None))
    if not is_complete:
        lost.append(LostMessages(None, None, max(ends, default=None), None))
    return tuple(lost)


ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True, eq=False)
class SalvagedLog:
    """Undamaged content of a damaged log."""

    metadata: Mapping[str, Mapping[str, str]]
    """Format and header records; no header if its CRC does not match."""
    chunks: tuple[IntactChunk, ...]
    channels: Mapping[int, Channel]
    schemas: Mapping[int, Schema]
    lost: tuple[LostMessages, ...]
    lost_before: tuple[LostMessages, ...]
    """Losses that earlier recoveries reported."""
    notes: tuple[str, ...]
    """Sentences about parts of the file that belong to another log, or are out of order."""
    interrupted_by: str = ""
    """Cause if the run was interrupted."""


def intact_chunks(data: bytes, at: int) -> Iterator[bytes]:
    """Yield the records of each chunk from byte `at` on whose CRC matches; bytes around it may be damaged."""
    decompressor = zstandard.ZstdDecompressor()
    view = memoryview(data)
    while (found := data.find(ZSTD_MAGIC, at)) >= 0:
        at = found + len(ZSTD_MAGIC)
        if found < CHUNK_HEAD.size:
            continue
        crc32 = CHUNK_HEAD.unpack_from(data, found - CHUNK_HEAD.size)[3]
        try:
            size = zstandard.frame_content_size(view[found : found + 18])
            if not 0 <= size <= MAX_CHUNK_BYTES:
                continue
            # The decompressor finds the end of the frame; this is an upper limit of its size.
            frame = view[found : found + size + (size >> 8) + 512]
            one = decompressor.decompressobj()
            plain = one.decompress(frame)
        except PARSE_ERRORS:
            continue
        if one.eof and len(plain) == size and zlib.crc32(plain) == crc32:
            yield plain
            at = found + len(frame) - len(one.unused_data)


def has_intact_chunk(data: bytes, at: int) -> bool:
    """Return whether there is an intact chunk from byte `at` on."""
    return next(intact_chunks(data, at), None) is not None


def salvage(data: bytes) -> SalvagedLog:
    """Find all content of a file that a CRC confirms; if the file holds several logs, of the first."""
    data, notes = first_log(data)
    metadata = _find_metadata(data)
    channels, schemas, totals = _parse_summary(data)
    chunks, size = [], 0
    for plain in intact_chunks(data, 0):
        size += len(plain)
        if size > MAX_UNPACKED_BYTES:
            notes.append(f"it unpacks to more than {MAX_UNPACKED_BYTES / 1e9:.1f} GB; the rest was left out")
            break
        try:
            starts = walk_records(plain, channels)
            schemas |= {schema.id: schema for schema in _parse_schemas(plain)}
        except PARSE_ERRORS:
            continue
        heads = heads_at(np.frombuffer(plain, np.uint8), np.array(starts, np.int64))
        chunks.append(IntactChunk(plain, starts, heads))
    chunks = sort_chunks(chunks, notes)
    try:
        names, declared = _declared_topics(metadata.get(HEADER_RECORD, {}))
    except PARSE_ERRORS:
        names, declared = {}, {}
        del metadata[HEADER_RECORD]
        notes.append("its header does not describe its topics and was left out")
    _add_declared(declared, channels, schemas)
    try:
        lost_before = losses_in(metadata.pop(RECOVERED_RECORD, {}))
    except PARSE_ERRORS:
        lost_before = (LostMessages(None, None, None, None),)
    try:
        interrupted_by = interruption_in(metadata.pop(END_RECORD, {}))
    except ValueError:
        interrupted_by = ""
        notes.append("what it says of its end is damaged and left out")
    names |= {number: channel.topic for number, channel in channels.items()}
    lost = find_losses(chunks, names, set(channels), totals, totals is not None or _is_complete(data))
    return SalvagedLog(
        metadata, tuple(chunks), channels, schemas, lost, lost_before, tuple(notes), interrupted_by
    )


def first_log(data: bytes) -> tuple[bytes, list[str]]:
    """Return the first log of a file, up to the magic that ends it or begins another, and notes on the rest.

    Every run numbers its messages from 0, so chunks of two runs must not be mixed.
    """
    end = find_log_end(data, len(MCAP0_MAGIC))
    if end is None or end == len(data):
        return data, []
    return data[:end], [trailing_bytes_text(len(data) - end)]


def sort_chunks(chunks: Sequence[IntactChunk], notes: list[str]) -> list[IntactChunk]:
    """Return each chunk once, in the order of writing; `notes` receives a sentence for each change."""
    once = list({chunk.plain: chunk for chunk in chunks}.values())
    if len(once) < len(chunks):
        count = len(chunks) - len(once)
        notes.append("1 chunk is in it twice" if count == 1 else f"{count} chunks are in it twice")
    ordered = sorted(once, key=_chunk_sort_key)
    if ordered != once:
        notes.append("its chunks are out of order")
    return ordered


def _chunk_sort_key(chunk: IntactChunk) -> tuple[int, ...]:
    """Return time, channel and sequence number of the first message; a chunk without messages sorts first."""
    if not len(chunk.heads):
        return ()
    first = chunk.heads[0]
    return int(chunk.heads["time_ns"].min()), int(first["channel"]), int(first["sequence"])


def _declared_topics(
    header: Mapping[str, str],
) -> tuple[dict[int, str], dict[int, tuple[KnownTopic, str]]]:
    """Return the topics of a header, and its flight channels with the names of their schemas, by number.

    Raises:
        KeyError, TypeError, AttributeError, ValueError: the header is damaged or of another kind.
    """
    documents = decode_topics(header)
    found = {number: (one, documents[number]["schema"]) for number, one in known_topics(header, {}).items()}
    if not all(isinstance(name, str) for _, name in found.values()):
        raise TypeError("a schema's name is not a text")
    return {number: document["topic"] for number, document in documents.items()}, found


def _add_declared(
    declared: Mapping[int, tuple[KnownTopic, str]], channels: dict[int, Channel], schemas: dict[int, Schema]
) -> None:
    """Add the flight channels whose records are lost, from their description in the header."""
    entries: dict[str, type[LogEntry]] = {EVR_TOPIC: EvrEntry, COMMAND_TOPIC: CommandEntry}
    for number in sorted(set(declared) - set(channels)):
        one, schema_name = declared[number]
        text = one.layout.ros_text if one.layout is not None else entries[one.topic].ros_text()
        schema_id = max(schemas, default=0) + 1
        schemas[schema_id] = Schema(
            id=schema_id, name=schema_name, encoding="ros2msg", data=ros_definition(None, text)
        )
        metadata = {} if one.layout is None else {LAYOUT_KEY: one.layout.to_json()}
        if one.is_truth:
            metadata[TRUTH_KEY] = TRUTH_TEXT
        channels[number] = Channel(
            id=number, topic=one.topic, message_encoding="cdr", metadata=metadata, schema_id=schema_id
        )


def _parse_summary(data: bytes) -> tuple[dict[int, Channel], dict[int, Schema], dict[int, int] | None]:
    """Return channels, schemas and the number of messages by channel, as far as the summary is undamaged."""
    channels, schemas, totals = dict[int, Channel](), dict[int, Schema](), None
    for opcode, body in read_summary(data):
        if opcode == Opcode.CHANNEL:
            channel = parse_channel(body)
            channels[channel.id] = channel
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(body)))
            schemas[schema.id] = schema
        elif opcode == Opcode.STATISTICS:
            totals = dict(Statistics.read(ReadDataStream(BytesIO(body))).channel_message_counts)
    return channels, schemas, totals


def _parse_schemas(plain: bytes) -> Iterator[Schema]:
    for _, opcode, body in iter_records(plain, 0):
        if opcode == Opcode.SCHEMA:
            yield Schema.read(ReadDataStream(BytesIO(body)))


def _find_metadata(data: bytes) -> dict[str, dict[str, str]]:
    """Find format, header, recovery and end records anywhere in a file; a header only if its CRC matches."""
    found = {}
    for name in (FORMAT_RECORD, HEADER_RECORD, RECOVERED_RECORD, END_RECORD):
        encoded_name = len(name).to_bytes(4, "little") + name.encode()
        at = data.find(encoded_name)
        if at < RECORD_HEAD.size:
            continue
        try:
            record = Metadata.read(ReadDataStream(BytesIO(data[at:])))
        except PARSE_ERRORS:
            continue
        found[name] = record.metadata
    expected = found.get(FORMAT_RECORD, {}).get("header_crc32")
    if HEADER_RECORD in found and header_crc32(found[HEADER_RECORD]) != expected:
        del found[HEADER_RECORD]
    return found


def _is_complete(data: bytes) -> bool:
    """Return whether the data section ends with a data end record whose CRC matches."""
    body = (4).to_bytes(8, "little")
    at = data.rfind(bytes([Opcode.DATA_END]) + body)
    size = RECORD_HEAD.size
    return at > 0 and data[at + size : at + size + 4] == compute_crc32(data, 0, at).to_bytes(4, "little")
