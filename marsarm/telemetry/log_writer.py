"""Writing of message records: packing of a cycle's packets, and the chunks of a log that is being recorded.

Packing and chunks are the part of recording that every cycle pays for. A call of the library for each message
would cost more than all of it, so one call of struct packs the numbers of a cycle. The result is cut,
and one join puts the pieces and the arrays in order. The join copies the arrays, so no reference to the cycle
remains.
The records around the messages are the library's.
"""

import errno
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from io import FileIO
from itertools import accumulate, count, groupby
from operator import attrgetter, itemgetter
from struct import Struct, calcsize, pack
from struct import error as StructError
from typing import Any, Final, NamedTuple

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

from marsarm.telemetry.errors import SchemaError
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.schema import ENCAPSULATION, Layout

MESSAGE_START: Final = Struct("<BQH")
"""Start of a message record: opcode, length of the rest, channel; constant for a fixed layout."""
RECORD_HEAD: Final = Struct("<BQ")
"""Head of any record: opcode, length of the rest."""
INDEX_HEAD: Final = Struct("<BQHI")
"""Head of a message index: opcode, length of the rest, channel, bytes of entries."""
MESSAGE_HEADER: Final = Struct("<BQHIQQ")
"""Opcode, length of the rest, channel, sequence, log time and publish time of a message record."""
AFTER_LENGTH: Final = MESSAGE_HEADER.size - 9
"""Bytes of the header after the length."""
DTYPE: Final = attrgetter("dtype")
STRUCT_CODES: Final = {"<i8": "q", "<f8": "d", "|b1": "?"}
"""Code of `struct` for a number of each numpy type."""


def message_record(channel: int, sequence: int, time_ns: int, data: bytes) -> bytes:
    """Encode one message as an MCAP record."""
    head = MESSAGE_HEADER.pack(Opcode.MESSAGE, AFTER_LENGTH + len(data), channel, sequence, time_ns, time_ns)
    return head + data


def number_messages(counts: dict[int, int], time_ns: int, messages: Sequence[tuple[int, bytes]]) -> bytes:
    """Encode messages by channel as records of one time, numbered by the counts, which rise here."""
    records = []
    for channel, data in messages:
        records.append(message_record(channel, counts[channel], time_ns, data))
        counts[channel] += 1
    return b"".join(records)


def join_bytes(pieces: Sequence[Any]) -> bytes:
    """Join bytes and arrays, one after the other."""
    try:
        return b"".join(pieces)
    except TypeError:  # an array that does not lie row by row in memory
        return b"".join([p.tobytes() if isinstance(p, np.ndarray) else p for p in pieces])


class PacketSource(NamedTuple):
    """Source of the packets of a channel: `path` is their dotted name in the record of a cycle."""

    path: str
    channel: int
    layout: Layout


class Packer:
    """Packer of the packets that occur together in a cycle; no layout needs padding."""

    def __init__(self, sources: Sequence[PacketSource]) -> None:
        self._fields = [(f"{path}.{f.name}", f) for path, _, layout in sources for f in layout.fields]
        numbers = [name for name, f in self._fields if f.shape is None]
        arrays = [name for name, f in self._fields if f.shape is not None]
        starts = [f"start of {path}" for path, _, _ in sources]
        counts = [f"count of {path}" for path, _, _ in sources]
        values = ["time", "encapsulation", *starts, *counts, *numbers]
        order: list[tuple[str, str]] = []  # struct code of each value, empty for an array, and its name
        for path, _, layout in sources:
            order += [(f"{MESSAGE_START.size}s", f"start of {path}"), ("I", f"count of {path}")]
            order += [("Q", "time"), ("Q", "time"), (f"{len(ENCAPSULATION)}s", "encapsulation")]
            order += [
                (STRUCT_CODES[f.kind] if f.shape is None else "", f"{path}.{f.name}") for f in layout.fields
            ]
        runs = [(code, [*run]) for code, run in groupby(order, lambda one: "" if one[0] else one[1])]
        sizes = [calcsize("<" + "".join(code for code, _ in run)) for array, run in runs if not array]
        ends = [*accumulate(sizes)]
        place_of_cut = count()
        self._starts = [
            MESSAGE_START.pack(Opcode.MESSAGE, AFTER_LENGTH + layout.dtype.itemsize, channel)
            for _, channel, layout in sources
        ]
        self._numbers, self._arrays = attrgetter(*numbers), attrgetter(*arrays)
        self._values = itemgetter(*[values.index(name) for code, name in order if code])
        self._pack = Struct("<" + "".join(code for code, _ in order)).pack
        self._cut = itemgetter(*map(slice, [0, *ends], ends))
        self._pieces = itemgetter(
            *[len(ends) + arrays.index(array) if array else next(place_of_cut) for array, _ in runs]
        )
        self._dtypes = [np.dtype(f.kind) for _, f in self._fields if f.shape is not None]
        self._size = sum(MESSAGE_HEADER.size + layout.dtype.itemsize for _, _, layout in sources)

    def pack(self, cycle: Any, time_ns: int, counts: Sequence[int]) -> bytes:
        """Encode the packets of a cycle as message records.

        Args:
            cycle: Record of the cycle.
            time_ns: Log time.
            counts: Sequence number of each packet, in the order of the sources.

        Raises:
            SchemaError: an array has not the type of the layout, or a number does not fit.
        """
        arrays = self._arrays(cycle)
        values = (time_ns, ENCAPSULATION, *self._starts, *counts, *self._numbers(cycle))
        try:
            packed = self._pack(*self._values(values))
        except StructError:
            self.check(cycle)
            raise
        data = join_bytes(self._pieces((*self._cut(packed), *arrays)))
        if [*map(DTYPE, arrays)] != self._dtypes or len(data) != self._size:
            self.check(cycle)
        return data

    def check(self, cycle: Any) -> None:
        """Check every field against the layout; SchemaError if a field differs; the message names it."""
        for name, field in self._fields:
            given, dtype = attrgetter(name)(cycle), np.dtype(field.kind)
            if field.shape is None:
                try:
                    Struct("<" + STRUCT_CODES[field.kind]).pack(given)
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
        file: FileIO,
        metadata: Sequence[Metadata],
        schemas: Sequence[Schema],
        channels: Sequence[Channel],
        chunk_cycles: int,
    ) -> None:
        """Write metadata, schemas and channels; the last two go into a chunk, so that they have a CRC.

        Raises:
            OSError: the disk is full or gone.
        """
        self._file = file
        self._compressor = ZstdCompressor(level=COMPRESSION_LEVEL)
        self._size, self._crc = 0, 0
        self._is_whole = True  # every record in the file is complete
        self._error: OSError | None = None
        self._schemas, self._channels = schemas, channels
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._rows: list[tuple[int, bytes]] = []
        self._chunk_ns = chunk_cycles * TICK_NS
        self.written_ns: int | None = None
        """Log time of the last cycle in the file; None before the first."""
        self._write(MCAP0_MAGIC + encode_records(Header("", "marsarm")))
        self._add_metadata(metadata)
        self._write_chunk(encode_records(*schemas, *channels), 0, 0, {})

    def add(self, time_ns: int, records: bytes) -> None:
        """Add the message records of a cycle; a chunk that is full goes to the operating system.

        Raises:
            OSError: the disk is full or gone.
        """
        self._rows.append((time_ns, records))
        if time_ns + TICK_NS - self._rows[0][0] >= self._chunk_ns:
            self._close_chunk()

    def finish(self, metadata: Sequence[Metadata]) -> None:
        """Write the waiting cycles, metadata and the summary, and close the file.

        Raises:
            OSError: the disk is full or gone.
        """
        with self._file:
            if self._error is not None:
                raise OSError(self._error.errno, self._error.strerror)
            if not self._is_whole:  # an interrupt came between; nothing after half a record could be read
                return
            if self._rows:
                self._close_chunk()
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

    def _close_chunk(self) -> None:
        entries: dict[int, list[int]] = defaultdict(list)  # log time and place of each message, by channel
        begin = 0
        for time_ns, records in self._rows:
            at = 0
            while at < len(records):
                _, length, channel = MESSAGE_START.unpack_from(records, at)
                entries[channel] += (time_ns, begin + at)
                at += RECORD_HEAD.size + length
            begin += at
        first_ns, last_ns = self._rows[0][0], self._rows[-1][0]
        self._write_chunk(b"".join([records for _, records in self._rows]), first_ns, last_ns, entries)
        for channel, numbers in entries.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(numbers) // 2
        self._rows, self.written_ns = [], last_ns

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
