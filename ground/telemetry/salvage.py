"""What is undamaged in a damaged log, and what is missing between."""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics
from numpy.typing import NDArray

from ground.telemetry.chunks import HEAD, heads_at, walk
from ground.telemetry.container import (
    CHUNK_HEAD,
    CHUNK_LIMIT,
    NOT_AS_WRITTEN,
    RECORD_HEAD,
    channel_of,
    crc32_of,
    records,
    summary_of,
)
from ground.telemetry.format import FORMAT_RECORD, HEADER_RECORD, header_crc32
from ground.telemetry.loss import RECOVERED_RECORD, Lost, lost_in

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """A chunk whose CRC holds: its records, and the heads of its messages, type HEAD, shape (n,)."""

    plain: bytes
    starts: list[int]
    heads: NDArray[np.void]


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
    """Look for everything in a file that its checks still vouch for."""
    channels, schemas, totals = _summary(data)
    chunks = []
    for plain in good_chunks(data, 0):
        try:
            starts = walk(plain, channels)
            schemas |= {schema.id: schema for schema in _schemas(plain)}
        except NOT_AS_WRITTEN:
            continue
        heads = heads_at(np.frombuffer(plain, np.uint8), np.array(starts, np.int64))
        chunks.append(Saved(plain, starts, heads))
    metadata = _metadata(data)
    try:
        lost_before = lost_in(metadata.pop(RECOVERED_RECORD, {}))
    except NOT_AS_WRITTEN:
        lost_before = (Lost(None, None, None, None),)
    lost = _lost(chunks, channels, totals, data)
    return Salvage(metadata, tuple(chunks), channels, schemas, lost, lost_before)


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


@dataclass(frozen=True, slots=True)
class _Gap:
    """Messages missing of a channel: they stood behind chunk `after` and before chunk `before`."""

    channel: int
    count: int
    after: int
    before: int
    after_ns: int | None
    before_ns: int | None


def _gaps(chunks: Sequence[Saved], channels: Mapping[int, Channel], totals: dict[int, int]) -> list[_Gap]:
    """Where sequences break off, by channel; `totals` tell what is missing at the end."""
    heads = np.concatenate([np.zeros(0, HEAD), *(chunk.heads for chunk in chunks)])
    of_chunk = np.repeat(np.arange(len(chunks)), [len(chunk.heads) for chunk in chunks])
    gaps = []
    for number in sorted({*channels, *heads["channel"].tolist()}):
        rows = np.flatnonzero(heads["channel"] == number)
        counted = heads["sequence"][rows].astype(np.int64)
        before = np.append(-1, counted)
        for k in np.flatnonzero(np.diff(before) > 1):
            gaps.append(
                _Gap(
                    channel=number,
                    count=int(counted[k] - before[k] - 1),
                    after=-1 if k == 0 else int(of_chunk[rows[k - 1]]),
                    before=int(of_chunk[rows[k]]),
                    after_ns=None if k == 0 else int(heads["time_ns"][rows[k - 1]]),
                    before_ns=int(heads["time_ns"][rows[k]]),
                )
            )
        missing = totals.get(number, 0) - int(before[-1]) - 1
        if missing > 0:
            behind = int(of_chunk[rows[-1]]) if len(rows) else -1
            last_ns = int(heads["time_ns"][rows[-1]]) if len(rows) else None
            gaps.append(_Gap(number, missing, behind, len(chunks), last_ns, None))
    return gaps


def _lost(
    chunks: Sequence[Saved], channels: Mapping[int, Channel], totals: dict[int, int] | None, data: bytes
) -> tuple[Lost, ...]:
    gaps = _gaps(chunks, channels, totals or {})
    # A channel that speaks in every chunk shows at which seam something is missing; a rare one does not.
    seams = sorted({gap.after for gap in gaps if gap.before == gap.after + 1})
    ends = [int(chunk.heads["time_ns"].max()) if len(chunk.heads) else None for chunk in chunks]
    begins = [int(chunk.heads["time_ns"].min()) if len(chunk.heads) else None for chunk in chunks]
    lost = []
    for gap in gaps:
        inside = [seam for seam in seams if gap.after <= seam < gap.before] or [gap.after, gap.before - 1]
        channel = channels.get(gap.channel)
        topic = f"channel {gap.channel}" if channel is None else channel.topic
        after_ns = ends[inside[0]] if inside[0] >= 0 else gap.after_ns
        before_ns = begins[inside[-1] + 1] if inside[-1] + 1 < len(chunks) else gap.before_ns
        lost.append(Lost(topic, gap.count, after_ns, before_ns))
    for number in sorted({n for chunk in chunks for n in chunk.heads["channel"].tolist()} - set(channels)):
        count = sum(int((chunk.heads["channel"] == number).sum()) for chunk in chunks)
        lost.append(Lost(f"channel {number}", count, None, None))
    if totals is None and not _is_complete(data):
        known = [end for end in ends if end is not None]
        lost.append(Lost(None, None, max(known, default=None), None))
    return tuple(lost)


def _is_complete(data: bytes) -> bool:
    """Whether the CRC of all that the run wrote holds; it ends where the data end record stands."""
    body = (4).to_bytes(8, "little")
    at = data.rfind(bytes([Opcode.DATA_END]) + body)
    size = RECORD_HEAD.size
    return at > 0 and data[at + size : at + size + 4] == crc32_of(data, 0, at).to_bytes(4, "little")
