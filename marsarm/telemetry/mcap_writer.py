"""Writer of the MCAP container: chunks with their message indexes, and a summary at the end."""

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdCompressor

from marsarm.telemetry.mcap_reader import CHUNK_HEAD, RECORD_HEAD

COMPRESSION_LEVEL: Final = -5
"""Level of zstd: a log is an eighth larger than at level 1, and takes half the time."""
INDEX_HEAD: Final = struct.Struct("<BQHI")
"""Head of a message index: opcode, length of the rest, channel, bytes of entries."""
FOOTER_HEAD: Final = struct.Struct("<BQQQ")
MESSAGE_START: Final = struct.Struct("<BQH")
"""Start of a message record: opcode, length of the rest, channel; constant for a fixed layout."""


class RawFile(Protocol):
    """Unbuffered file."""

    def write(self, data: memoryview, /) -> int | None:
        """Write a part of the data and return its size in bytes."""

    def truncate(self, size: int, /) -> int:
        """Truncate the file."""

    def close(self) -> None:
        """Close the file."""


class LogRow(NamedTuple):
    """Message records of one log time, one after the other."""

    time_ns: int
    data: bytes


@dataclass(slots=True)
class McapState:
    """State of a file that is being written: all that the next chunk and the summary need."""

    size: int = 0
    crc: int = 0
    metadata: list[MetadataIndex] = field(default_factory=list)
    schemas: Sequence[Schema] = ()
    channels: Sequence[Channel] = ()
    chunks: list[ChunkIndex] = field(default_factory=list)
    first_ns: int = 0
    last_ns: int = 0
    by_channel: dict[int, int] = field(default_factory=dict)
    """Messages so far, by channel."""

    def count(self, first_ns: int, last_ns: int, entries: Mapping[int, list[int]]) -> None:
        """Count the messages of a chunk.

        Args:
            first_ns: First log time.
            last_ns: Last log time.
            entries: Log time and offset of each message, by channel.
        """
        self.first_ns = min(self.first_ns, first_ns) if self.by_channel else first_ns
        self.last_ns = max(self.last_ns, last_ns)
        for channel, numbers in entries.items():
            self.by_channel[channel] = self.by_channel.get(channel, 0) + len(numbers) // 2


class McapWriter:
    """Writer of whole chunks; the file is readable after each."""

    def __init__(self, file: RawFile, written: McapState | None = None) -> None:
        self._file = file
        self.written = written or McapState()
        self._compressor = ZstdCompressor(level=COMPRESSION_LEVEL)

    def begin(
        self, metadata: Sequence[Metadata], schemas: Sequence[Schema], channels: Sequence[Channel]
    ) -> None:
        """Write metadata, schemas and channels; the last two go into a chunk, so that they have a CRC."""
        self.written.schemas, self.written.channels = schemas, channels
        self._write(MCAP0_MAGIC + encode_record(Header("", "marsarm")))
        self._write(b"".join(self._encode_metadata(metadata)))
        self._write_chunk(b"".join(encode_record(one) for one in (*schemas, *channels)), 0, 0, {})

    def add_chunk(self, rows: Sequence[LogRow]) -> None:
        """Write one or more rows as one chunk with its message indexes."""
        entries: dict[int, list[int]] = defaultdict(list)
        at = 0
        for time_ns, data in rows:
            for channel, begin in message_offsets(data):
                entries[channel] += (time_ns, at + begin)
            at += len(data)
        times_ns = [row.time_ns for row in rows]
        first_ns, last_ns = min(times_ns), max(times_ns)
        self._write_chunk(b"".join([row.data for row in rows]), first_ns, last_ns, entries)
        self.written.count(first_ns, last_ns, entries)

    def finish(self, metadata: Sequence[Metadata] = ()) -> None:
        """Write metadata and the summary, which completes the file."""
        self._write(b"".join(self._encode_metadata(metadata)))
        end = encode_record(DataEnd(self.written.crc))
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: self.written.schemas,
            Opcode.CHANNEL: self.written.channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: self.written.chunks,
            Opcode.METADATA_INDEX: self.written.metadata,
        }
        start = at = self.written.size + len(end)
        parts, offsets = [], []
        for opcode, group in groups.items():
            part = b"".join(map(encode_record, group))
            offsets.append(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(part)))
            parts.append(part)
            at += len(part)
        summary = b"".join([*parts, *map(encode_record, offsets)])
        crc = zlib.crc32(FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, at), zlib.crc32(summary))
        self._write(end + summary + encode_record(Footer(start, at, crc)) + MCAP0_MAGIC)

    def close(self) -> None:
        """Close the file without a summary."""
        self._file.close()

    def _encode_metadata(self, metadata: Sequence[Metadata]) -> Iterator[bytes]:
        """Encode metadata for the present end of the file, and index it."""
        at = self.written.size
        for one in metadata:
            data = encode_record(one)
            self.written.metadata.append(MetadataIndex(length=len(data), name=one.name, offset=at))
            at += len(data)
            yield data

    def _statistics(self) -> Statistics:
        written = self.written
        return Statistics(
            attachment_count=0,
            channel_count=len(written.channels),
            channel_message_counts=written.by_channel,
            chunk_count=len(written.chunks),
            message_count=sum(written.by_channel.values()),
            message_end_time=written.last_ns,
            message_start_time=written.first_ns,
            metadata_count=len(written.metadata),
            schema_count=len(written.schemas),
        )

    def _write_chunk(
        self, data: bytes, first_ns: int, last_ns: int, entries: Mapping[int, list[int]]
    ) -> None:
        compressed = self._compressor.compress(data)
        head = CHUNK_HEAD.pack(first_ns, last_ns, len(data), zlib.crc32(data), 4, b"zstd", len(compressed))
        record = RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(compressed)) + head + compressed
        parts, offsets, at = [record], {}, self.written.size + len(record)
        for channel, numbers in entries.items():
            size = 8 * len(numbers)
            offsets[channel] = at
            parts.append(INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            parts.append(struct.pack(f"<{len(numbers)}Q", *numbers))
            at += INDEX_HEAD.size + size
        index = ChunkIndex(
            chunk_length=len(record),
            chunk_start_offset=self.written.size,
            compression="zstd",
            compressed_size=len(compressed),
            message_end_time=last_ns,
            message_index_length=at - self.written.size - len(record),
            message_index_offsets=offsets,
            message_start_time=first_ns,
            uncompressed_size=len(data),
        )
        self._write(b"".join(parts))
        self.written.chunks.append(index)

    def _write(self, data: bytes) -> None:
        """Write all of the data, or restore the file.

        Raises:
            OSError: the disk is full or gone.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError:
            self._file.truncate(self.written.size)
            raise
        self.written.crc = zlib.crc32(data, self.written.crc)
        self.written.size += len(data)


def message_offsets(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield channel and first byte of each message record."""
    at = 0
    while at < len(data):
        _, length, channel = MESSAGE_START.unpack_from(data, at)
        yield channel, at
        at += RECORD_HEAD.size + length


def encode_record(record: McapRecord) -> bytes:
    """Encode a record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # mcap annotates only part of itself
