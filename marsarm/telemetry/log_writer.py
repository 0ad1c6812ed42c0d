"""Writing of a log: packets as messages, and the chunks of messages in a file.

This is the part of recording that every cycle pays for; the library would take longer than all of it. The
records around the messages are the library's.
"""

import errno
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from io import FileIO
from itertools import compress
from operator import attrgetter
from struct import Struct, pack
from struct import error as StructError
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdCompressor

from marsarm.telemetry.format import TICK_NS, SchemaError
from marsarm.telemetry.schema import ENCAPSULATION, Layout

RECORD_HEAD: Final = Struct("<BQ")
"""Head of any record: opcode, length of the rest."""
INDEX_HEAD: Final = Struct("<BQHI")
"""Head of a message index: opcode, length of the rest, channel, bytes of entries."""
MESSAGE_HEADER: Final = Struct("<BQHIQQ")
"""Opcode, length of the rest, channel, sequence, log time and publish time of a message record."""
DTYPE: Final = attrgetter("dtype")
STRUCT_CODES: Final = {"<i8": "q", "<f8": "d", "|b1": "?"}
"""Code of `struct` for a number of each numpy type."""


class Packer:
    """Packer of the packets of a topic as messages; no layout needs padding."""

    def __init__(self, path: str, layout: Layout) -> None:
        """Prepare the message of a layout; `path` is the name of the packet, for errors."""
        self._path, self._fields, self._size = path, layout.fields, layout.dtype.itemsize
        names = [f.name for f in layout.fields]
        self._values = attrgetter(*names, names[0])  # a tuple also for one field
        self._is_array = [f.shape is not None for f in layout.fields]
        self._dtypes = [np.dtype(f.kind) for f in compress(layout.fields, self._is_array)]
        self._packs = [
            Struct("<" + STRUCT_CODES[f.kind]).pack if f.shape is None else None for f in layout.fields
        ]

    def pack(self, packet: Any) -> bytes:
        """Encode a packet; SchemaError if a field differs from the layout."""
        values = self._values(packet)
        try:
            pairs = zip(values, self._packs, strict=False)
            parts = [one if pack is None else pack(one) for one, pack in pairs]
        except StructError:
            self._check(values)
            raise
        try:
            data = b"".join((ENCAPSULATION, *parts))
        except TypeError:  # an array that does not lie row by row in memory
            data = b"".join((ENCAPSULATION, *[bytes(memoryview(part)) for part in parts]))
        if [*map(DTYPE, compress(values, self._is_array))] != self._dtypes or len(data) != self._size:
            self._check(values)
        return data

    def _check(self, values: Sequence[Any]) -> None:
        """Raise a SchemaError that names the first field that differs from the layout."""
        for field, given, packs in zip(self._fields, values, self._packs, strict=False):
            name, dtype = f"{self._path}.{field.name}", np.dtype(field.kind)
            if packs is not None:
                try:
                    packs(given)
                except StructError as error:
                    raise SchemaError(f"{name}: {given} given, {error}") from error
            elif given.dtype != dtype or given.shape != field.shape:
                raise SchemaError(
                    f"{name}: {given.dtype}{given.shape} given, {dtype}{field.shape} in the log's schema"
                )


COMPRESSION_LEVEL: Final = -5
"""Level of zstd: a log is an eighth larger than at level 1, and takes half the time."""


class ChunkWriter:
    """Writer of a log in chunks; the file is readable up to the last one."""

    def __init__(
        self,
        file: FileIO | BinaryIO,
        metadata: Sequence[Metadata],
        schemas: Sequence[Schema],
        channels: Sequence[Channel],
        chunk_cycles: int,
    ) -> None:
        """Write metadata, then schemas and channels in a chunk, which has a CRC; OSError if that fails."""
        self._file = file
        self._compressor = ZstdCompressor(level=COMPRESSION_LEVEL)
        self._size, self._crc = 0, 0
        self._is_whole = True  # every record in the file is complete
        self._error: OSError | None = None
        self._schemas, self._channels = schemas, channels
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._first_ns: int | None
        self._last_ns = 0
        self._plain_bytes: int
        self._parts: list[bytes]
        self._entries: dict[int, list[int]]  # log time and place of each message, by channel
        self._begin_chunk()
        self._chunk_ns = chunk_cycles * TICK_NS
        self.written_ns: int | None = None
        """Log time of the last cycle in the file; None before the first."""
        self._write(MCAP0_MAGIC + encode_records(Header("", "marsarm")))
        self._add_metadata(metadata)
        self._write_chunk(encode_records(*schemas, *channels), 0, 0, {})

    def add(self, time_ns: int, messages: Sequence[tuple[int, bytes]]) -> None:
        """Add messages of one time by channel, numbered here, and write a full chunk; OSError if it fails."""
        first_ns = self._first_ns = time_ns if self._first_ns is None else self._first_ns
        for channel, body in messages:
            length = MESSAGE_HEADER.size - RECORD_HEAD.size + len(body)
            number = self._counts[channel]
            self._counts[channel] = number + 1
            self._entries[channel] += (time_ns, self._plain_bytes)
            self._parts.append(
                MESSAGE_HEADER.pack(Opcode.MESSAGE, length, channel, number, time_ns, time_ns) + body
            )
            self._plain_bytes += RECORD_HEAD.size + length
        self._last_ns = time_ns
        if time_ns + TICK_NS - first_ns >= self._chunk_ns:
            self._close_chunk(first_ns)

    def finish(self, metadata: Sequence[Metadata]) -> None:
        """Write waiting cycles, metadata and summary, and close the file; OSError if the disk is full."""
        with self._file:
            if self._error is not None:
                raise OSError(self._error.errno, self._error.strerror)
            if not self._is_whole:  # an interrupt came between; nothing after half a record could be read
                return
            if self._first_ns is not None:
                self._close_chunk(self._first_ns)
            self._add_metadata(metadata)
            end = encode_records(DataEnd(self._crc))
            summary = encode_records(
                *self._schemas, *self._channels, self._statistics(), *self._chunks, *self._metadata
            )
            start = self._size + len(end)
            footer = encode_records(Footer(start, 0, 0))[:-4]  # without its own CRC
            crc = zlib.crc32(footer, zlib.crc32(summary))
            self._write(end + summary + footer + crc.to_bytes(4, "little") + MCAP0_MAGIC)

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _begin_chunk(self) -> None:
        self._first_ns, self._plain_bytes = None, 0
        self._parts, self._entries = [], defaultdict(list)

    def _close_chunk(self, first_ns: int) -> None:
        self._write_chunk(b"".join(self._parts), first_ns, self._last_ns, self._entries)
        self.written_ns = self._last_ns
        self._begin_chunk()

    def _write_chunk(
        self, data: bytes, first_ns: int, last_ns: int, entries: Mapping[int, Sequence[int]]
    ) -> None:
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(data),
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        record, offsets, after = encode_records(chunk), {}, b""
        for channel, numbers in entries.items():
            offsets[channel] = self._size + len(record) + len(after)
            size = 8 * len(numbers)
            after += INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size)
            after += pack(f"<{len(numbers)}Q", *numbers)  # the library would take as long as for the chunk
        about = ChunkIndex(
            chunk_length=len(record),
            chunk_start_offset=self._size,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=last_ns,
            message_index_length=len(after),
            message_index_offsets=offsets,
            message_start_time=first_ns,
            uncompressed_size=len(data),
        )
        self._write(record + after)
        self._chunks.append(about)

    def _add_metadata(self, metadata: Sequence[Metadata]) -> None:
        for one in metadata:
            data = encode_records(one)
            self._metadata.append(MetadataIndex(offset=self._size, length=len(data), name=one.name))
            self._write(data)

    def _statistics(self) -> Statistics:
        used = [one for one in self._chunks if one.message_index_offsets]
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((one.message_end_time for one in used), default=0),
            message_start_time=min((one.message_start_time for one in used), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _write(self, data: bytes) -> None:
        if not self._is_whole:
            raise OSError(errno.EIO, "an earlier part of it could not be written")
        self._is_whole = False
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError as error:
            self._error = error
            raise
        self._is_whole = True
        self._crc = zlib.crc32(data, self._crc)
        self._size += len(data)


def encode_records(*records: McapRecord) -> bytes:
    """Encode records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # mcap annotates only part of itself
