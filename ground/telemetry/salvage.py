"""What is undamaged in a damaged log, and what is missing between."""

import zlib
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from ground.telemetry.chunks import MESSAGE_DTYPE, MESSAGE_OVERHEAD, heads_at, walk_records
from ground.telemetry.events import CommandEntry, EvrEntry, LogEntry
from ground.telemetry.format import (
    COMMAND_TOPIC,
    EVR_TOPIC,
    FORMAT_RECORD,
    HEADER_RECORD,
    LAYOUT_KEY,
    TRUTH_KEY,
    TRUTH_TEXT,
    header_crc32,
)
from ground.telemetry.lost_messages import RECOVERED_RECORD, LostMessages, losses_in, trailing_bytes_text
from ground.telemetry.mcap_reader import (
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
from ground.telemetry.schema import ros_definition
from ground.telemetry.topic_arrays import decode_topics, known_topics


@dataclass(frozen=True, slots=True, eq=False)
class IntactChunk:
    """A chunk whose CRC holds: its records, and the heads of its messages, type HEAD, shape (n,)."""

    plain: bytes
    starts: list[int]
    heads: NDArray[np.void]

    def messages(self) -> Iterator[tuple[int, int, int, int, bytes]]:
        """Channel, sequence, log time, publish time and body of each message."""
        for start, head in zip(self.starts, self.heads.tolist(), strict=True):
            _, length, *rest = head
            begin = start + MESSAGE_DTYPE.itemsize
            yield (*rest, self.plain[begin : begin + length - MESSAGE_OVERHEAD])


@dataclass(frozen=True, slots=True)
class MissingRange:
    """Messages missing of a channel: they stood behind chunk `after` and before chunk `before`."""

    channel: int
    count: int
    after: int
    before: int


def find_missing(
    chunks: Sequence[IntactChunk], numbers: Set[int], totals: Mapping[int, int]
) -> list[MissingRange]:
    """Where the sequences of these channels break off; `totals` tell what is missing at the end."""
    heads = np.concatenate([np.zeros(0, MESSAGE_DTYPE), *(chunk.heads for chunk in chunks)])
    of_chunk = np.repeat(np.arange(len(chunks)), [len(chunk.heads) for chunk in chunks])
    gaps = []
    for number in sorted(numbers | set(heads["channel"].tolist())):
        rows = np.flatnonzero(heads["channel"] == number)
        counted = heads["sequence"][rows].astype(np.int64)
        before = np.append(-1, counted)
        for k in np.flatnonzero(np.diff(before) > 1):
            gaps.append(
                MissingRange(
                    channel=number,
                    count=int(counted[k] - before[k] - 1),
                    after=-1 if k == 0 else int(of_chunk[rows[k - 1]]),
                    before=int(of_chunk[rows[k]]),
                )
            )
        missing = totals.get(number, 0) - int(before[-1]) - 1
        if missing > 0:
            behind = int(of_chunk[rows[-1]]) if len(rows) else -1
            gaps.append(MissingRange(number, missing, behind, len(chunks)))
    return gaps


def find_losses(
    chunks: Sequence[IntactChunk],
    names: Mapping[int, str],
    known: Set[int],
    totals: Mapping[int, int] | None,
    is_complete: bool,
) -> tuple[LostMessages, ...]:
    """What is missing before, between and after these chunks; `names` has the topics of channels.

    Messages of channels that are not `known` cannot be told from noise, and are lost as well. Unless the log
    `is_complete`, nobody knows what came after its end.
    """
    chunks = [chunk for chunk in chunks if len(chunk.heads)]
    heads = np.concatenate([np.zeros(0, MESSAGE_DTYPE), *(chunk.heads for chunk in chunks)])
    gaps = find_missing(chunks, known, totals or {})
    # A channel that speaks in every chunk shows at which seam something is missing; a rare one does not.
    seams = sorted({gap.after for gap in gaps if gap.before == gap.after + 1})
    ends = [int(chunk.heads["time_ns"].max()) for chunk in chunks]
    begins = [int(chunk.heads["time_ns"].min()) for chunk in chunks]

    def lost_at(number: int, count: int | None, first: int, last: int) -> LostMessages:
        """Messages lost from behind one chunk to before the one behind another."""
        after_ns = ends[first] if first >= 0 else None
        before_ns = begins[last + 1] if last + 1 < len(chunks) else None
        return LostMessages(names.get(number, f"channel {number}"), count, after_ns, before_ns)

    lost = []
    for gap in gaps:
        inside = [seam for seam in seams if gap.after <= seam < gap.before] or [gap.after, gap.before - 1]
        lost.append(lost_at(gap.channel, gap.count, inside[0], inside[-1]))
    for number in sorted(known) if totals is None else ():
        # Of a channel that is silent afterwards, nothing tells whether it spoke at a seam.
        speaks = [k for k, chunk in enumerate(chunks) if (chunk.heads["channel"] == number).any()]
        behind = [seam for seam in seams if seam >= max(speaks, default=-1)]
        if behind:
            lost.append(lost_at(number, None, behind[0], behind[-1]))
    for number in sorted(set(heads["channel"].tolist()) - known):
        count = int((heads["channel"] == number).sum())
        lost.append(LostMessages(names.get(number, f"channel {number}"), count, None, None))
    if not is_complete:
        lost.append(LostMessages(None, None, max(ends, default=None), None))
    return tuple(lost)


ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True, eq=False)
class SalvagedLog:
    """All that a damaged log still holds for sure."""

    metadata: Mapping[str, Mapping[str, str]]
    """The format and header records; without the header where its CRC does not hold."""
    chunks: tuple[IntactChunk, ...]
    channels: Mapping[int, Channel]
    schemas: Mapping[int, Schema]
    lost: tuple[LostMessages, ...]
    lost_before: tuple[LostMessages, ...]
    """In recoveries before this one."""
    notes: tuple[str, ...]
    """Sentences about what in the file is not of this log, or not in its place."""


def intact_chunks(data: bytes, at: int) -> Iterator[bytes]:
    """The records of each chunk from byte `at` on whose CRC holds, whatever became of the bytes around it."""
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
            # The frame knows its end; no frame is larger than this.
            frame = view[found : found + size + (size >> 8) + 512]
            one = decompressor.decompressobj()
            plain = one.decompress(frame)
        except PARSE_ERRORS:
            continue
        if one.eof and len(plain) == size and zlib.crc32(plain) == crc32:
            yield plain
            at = found + len(frame) - len(one.unused_data)


def has_intact_chunk(data: bytes, at: int) -> bool:
    """Whether there is an undamaged chunk from byte `at` on."""
    return next(intact_chunks(data, at), None) is not None


def salvage(data: bytes) -> SalvagedLog:
    """Look for everything in a file that its checks still vouch for; of several logs, in the first."""
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
    header = metadata.get(HEADER_RECORD, {})
    _add_declared(header, channels, schemas)
    try:
        lost_before = losses_in(metadata.pop(RECOVERED_RECORD, {}))
    except PARSE_ERRORS:
        lost_before = (LostMessages(None, None, None, None),)
    names = {number: said["topic"] for number, said in _declared_topics(header).items()}
    names |= {number: channel.topic for number, channel in channels.items()}
    lost = find_losses(chunks, names, set(channels), totals, totals is not None or _is_complete(data))
    return SalvagedLog(metadata, tuple(chunks), channels, schemas, lost, lost_before, tuple(notes))


def first_log(data: bytes) -> tuple[bytes, list[str]]:
    """The first log in a file, to behind the magic that ends it or begins another; what is left out.

    Every run counts its messages from 0, so chunks of two runs would make one false log.
    """
    end = find_log_end(data, len(MCAP0_MAGIC))
    if end is None or end == len(data):
        return data, []
    return data[:end], [trailing_bytes_text(len(data) - end)]


def sort_chunks(chunks: Sequence[IntactChunk], notes: list[str]) -> list[IntactChunk]:
    """Each chunk once, in the order in which they were written."""
    once = list({chunk.plain: chunk for chunk in chunks}.values())
    if len(once) < len(chunks):
        count = len(chunks) - len(once)
        notes.append("1 chunk stands in it twice" if count == 1 else f"{count} chunks stand in it twice")
    ordered = sorted(once, key=_chunk_sort_key)
    if ordered != once:
        notes.append("its chunks are out of order")
    return ordered


def _chunk_sort_key(chunk: IntactChunk) -> tuple[int, ...]:
    """Time of a chunk's first message, its channel and number; a chunk of declarations comes first."""
    if not len(chunk.heads):
        return ()
    first = chunk.heads[0]
    return int(chunk.heads["time_ns"].min()), int(first["channel"]), int(first["sequence"])


def _declared_topics(header: Mapping[str, str]) -> dict[int, dict[str, Any]]:
    """What a header says of its channels; nothing where it is another's."""
    try:
        return decode_topics(header)
    except PARSE_ERRORS:
        return {}


def _add_declared(
    header: Mapping[str, str], channels: dict[int, Channel], schemas: dict[int, Schema]
) -> None:
    """Add the channels that only the header knows any more; those that were derived from them stay away."""
    said = _declared_topics(header)
    try:
        known = known_topics(header, {})
    except PARSE_ERRORS:
        return
    entries: dict[str, type[LogEntry]] = {EVR_TOPIC: EvrEntry, COMMAND_TOPIC: CommandEntry}
    for number in sorted(set(known) - set(channels)):
        one = known[number]
        text = one.layout.ros_text if one.layout is not None else entries[one.topic].ros_text()
        schema_id = max(schemas, default=0) + 1
        schemas[schema_id] = Schema(
            id=schema_id, name=said[number]["schema"], encoding="ros2msg", data=ros_definition(None, text)
        )
        metadata = {} if one.layout is None else {LAYOUT_KEY: one.layout.to_json()}
        if one.is_truth:
            metadata[TRUTH_KEY] = TRUTH_TEXT
        channels[number] = Channel(
            id=number, topic=one.topic, message_encoding="cdr", metadata=metadata, schema_id=schema_id
        )


def _parse_summary(data: bytes) -> tuple[dict[int, Channel], dict[int, Schema], dict[int, int] | None]:
    """Channels, schemas and how many messages each channel had, if the log's summary is as written."""
    channels, schemas, totals = dict[int, Channel](), dict[int, Schema](), None
    for opcode, body in read_summary(data):  # its CRC holds
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
    """The format and header records, wherever they are; the header only with the CRC that it should have."""
    found = {}
    for name in (FORMAT_RECORD, HEADER_RECORD, RECOVERED_RECORD):
        word = len(name).to_bytes(4, "little") + name.encode()
        at = data.find(word)
        if at < RECORD_HEAD.size:
            continue
        try:
            record = Metadata.read(ReadDataStream(BytesIO(data[at:])))
        except PARSE_ERRORS:
            continue
        found[name] = record.metadata
    due = found.get(FORMAT_RECORD, {}).get("header_crc32")
    if HEADER_RECORD in found and header_crc32(found[HEADER_RECORD]) != due:
        del found[HEADER_RECORD]
    return found


def _is_complete(data: bytes) -> bool:
    """Whether the CRC of all that the run wrote holds; it ends where the data end record stands."""
    body = (4).to_bytes(8, "little")
    at = data.rfind(bytes([Opcode.DATA_END]) + body)
    size = RECORD_HEAD.size
    return at > 0 and data[at + size : at + size + 4] == compute_crc32(data, 0, at).to_bytes(4, "little")
