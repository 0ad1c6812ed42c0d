"""What is undamaged in a damaged log, and what is missing between."""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from ground.telemetry.chunks import heads_at, walk
from ground.telemetry.container import (
    CHUNK_HEAD,
    CHUNK_LIMIT,
    MOST_UNPACKED,
    NOT_AS_WRITTEN,
    RECORD_HEAD,
    channel_of,
    crc32_of,
    end_of,
    records,
    summary_of,
)
from ground.telemetry.events import CommandEntry, Entry, EvrEntry
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
from ground.telemetry.gaps import Saved, lost_between
from ground.telemetry.loss import RECOVERED_RECORD, Lost, behind_text, lost_in
from ground.telemetry.messages import announced, known_channels
from ground.telemetry.schema import definition

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True, eq=False)
class Salvage:
    """All that a damaged log still holds for sure."""

    metadata: Mapping[str, Mapping[str, str]]
    """The format and header records; without the header where its CRC does not hold."""
    chunks: tuple[Saved, ...]
    channels: Mapping[int, Channel]
    schemas: Mapping[int, Schema]
    lost: tuple[Lost, ...]
    lost_before: tuple[Lost, ...]
    """In recoveries before this one."""
    notes: tuple[str, ...]
    """Sentences about what in the file is not of this log, or not in its place."""


def good_chunks(data: bytes, at: int) -> Iterator[bytes]:
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
            if not 0 <= size <= CHUNK_LIMIT:
                continue
            # The frame knows its end; no frame is larger than this.
            frame = view[found : found + size + (size >> 8) + 512]
            one = decompressor.decompressobj()
            plain = one.decompress(frame)
        except NOT_AS_WRITTEN:
            continue
        if one.eof and len(plain) == size and zlib.crc32(plain) == crc32:
            yield plain
            at = found + len(frame) - len(one.unused_data)


def has_chunk(data: bytes, at: int) -> bool:
    """Whether there is an undamaged chunk from byte `at` on."""
    return next(good_chunks(data, at), None) is not None


def salvage(data: bytes) -> Salvage:
    """Look for everything in a file that its checks still vouch for; of several logs, in the first."""
    data, notes = first_log(data)
    metadata = _metadata(data)
    channels, schemas, totals = _summary(data)
    chunks, size = [], 0
    for plain in good_chunks(data, 0):
        size += len(plain)
        if size > MOST_UNPACKED:
            notes.append(f"it unpacks to more than {MOST_UNPACKED / 1e9:.1f} GB; the rest was left out")
            break
        try:
            starts = walk(plain, channels)
            schemas |= {schema.id: schema for schema in _schemas(plain)}
        except NOT_AS_WRITTEN:
            continue
        heads = heads_at(np.frombuffer(plain, np.uint8), np.array(starts, np.int64))
        chunks.append(Saved(plain, starts, heads))
    chunks = in_order(chunks, notes)
    header = metadata.get(HEADER_RECORD, {})
    _declare(header, channels, schemas)
    try:
        lost_before = lost_in(metadata.pop(RECOVERED_RECORD, {}))
    except NOT_AS_WRITTEN:
        lost_before = (Lost(None, None, None, None),)
    names = {number: said["topic"] for number, said in _said(header).items()}
    names |= {number: channel.topic for number, channel in channels.items()}
    lost = lost_between(chunks, names, set(channels), totals, totals is not None or _is_complete(data))
    return Salvage(metadata, tuple(chunks), channels, schemas, lost, lost_before, tuple(notes))


def first_log(data: bytes) -> tuple[bytes, list[str]]:
    """The first log in a file, to behind the magic that ends it or begins another; what is left out.

    Every run counts its messages from 0, so chunks of two runs would make one false log.
    """
    end = end_of(data, len(MCAP0_MAGIC))
    if end is None or end == len(data):
        return data, []
    return data[:end], [behind_text(len(data) - end)]


def in_order(chunks: Sequence[Saved], notes: list[str]) -> list[Saved]:
    """Each chunk once, in the order in which they were written."""
    once = list({chunk.plain: chunk for chunk in chunks}.values())
    if len(once) < len(chunks):
        count = len(chunks) - len(once)
        notes.append("1 chunk stands in it twice" if count == 1 else f"{count} chunks stand in it twice")
    ordered = sorted(once, key=_begin)
    if ordered != once:
        notes.append("its chunks are out of order")
    return ordered


def _begin(chunk: Saved) -> tuple[int, ...]:
    """Time of a chunk's first message, its channel and number; a chunk of declarations comes first."""
    if not len(chunk.heads):
        return ()
    first = chunk.heads[0]
    return int(chunk.heads["time_ns"].min()), int(first["channel"]), int(first["sequence"])


def _said(header: Mapping[str, str]) -> dict[int, dict[str, Any]]:
    """What a header says of its channels; nothing where it is another's."""
    try:
        return announced(header)
    except NOT_AS_WRITTEN:
        return {}


def _declare(header: Mapping[str, str], channels: dict[int, Channel], schemas: dict[int, Schema]) -> None:
    """Add the channels that only the header knows any more; those that were derived from them stay away."""
    said = _said(header)
    try:
        known = known_channels(header, {})
    except NOT_AS_WRITTEN:
        return
    entries: dict[str, type[Entry]] = {EVR_TOPIC: EvrEntry, COMMAND_TOPIC: CommandEntry}
    for number in sorted(set(known) - set(channels)):
        one = known[number]
        text = one.layout.ros_text if one.layout is not None else entries[one.topic].ros_text()
        schema_id = max(schemas, default=0) + 1
        schemas[schema_id] = Schema(
            id=schema_id, name=said[number]["schema"], encoding="ros2msg", data=definition(None, text)
        )
        metadata = {} if one.layout is None else {LAYOUT_KEY: one.layout.to_json()}
        if one.is_truth:
            metadata[TRUTH_KEY] = TRUTH_TEXT
        channels[number] = Channel(
            id=number, topic=one.topic, message_encoding="cdr", metadata=metadata, schema_id=schema_id
        )


def _summary(data: bytes) -> tuple[dict[int, Channel], dict[int, Schema], dict[int, int] | None]:
    """Channels, schemas and how many messages each channel had, if the log's summary is as written."""
    channels, schemas, totals = dict[int, Channel](), dict[int, Schema](), None
    for opcode, body in summary_of(data):  # its CRC holds
        if opcode == Opcode.CHANNEL:
            channel = channel_of(body)
            channels[channel.id] = channel
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(body)))
            schemas[schema.id] = schema
        elif opcode == Opcode.STATISTICS:
            totals = dict(Statistics.read(ReadDataStream(BytesIO(body))).channel_message_counts)
    return channels, schemas, totals


def _schemas(plain: bytes) -> Iterator[Schema]:
    for _, opcode, body in records(plain, 0):
        if opcode == Opcode.SCHEMA:
            yield Schema.read(ReadDataStream(BytesIO(body)))


def _metadata(data: bytes) -> dict[str, dict[str, str]]:
    """The format and header records, wherever they are; the header only with the CRC that it should have."""
    found = {}
    for name in (FORMAT_RECORD, HEADER_RECORD, RECOVERED_RECORD):
        word = len(name).to_bytes(4, "little") + name.encode()
        at = data.find(word)
        if at < RECORD_HEAD.size:
            continue
        try:
            record = Metadata.read(ReadDataStream(BytesIO(data[at:])))
        except NOT_AS_WRITTEN:
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
    return at > 0 and data[at + size : at + size + 4] == crc32_of(data, 0, at).to_bytes(4, "little")
