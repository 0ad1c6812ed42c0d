"""Reader of the MCAP container: splits a marsarm log into records, and checks that they are as written."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Metadata
from mcap.writer import MCAP0_MAGIC

from marsarm.telemetry.errors import LogNotReadable
from marsarm.telemetry.format import FORMAT_RECORD, HEADER_RECORD, header_crc32, version_problem

RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQII4sQ")
"""Head of a chunk: first and last log time, size and CRC decompressed, name of the compression, data size."""

FOOTER_SIZE: Final = RECORD_HEAD.size + 8 + 8 + 4

MESSAGE_INDEX: Final = int(Opcode.MESSAGE_INDEX)
"""Opcode as an int: most records are message indexes, and an enum compares slowly."""

ENTRIES_SIZE: Final = struct.Struct("<I")

MAX_CHUNK_BYTES: Final = 1 << 26
"""Limit of the decompressed size that a chunk may claim; the recorder writes a million bytes at most."""

MAX_UNPACKED_BYTES: Final = 1 << 33
"""Limit of bytes decompressed at once: a day of telemetry. A small file of zeros could claim any size."""

PARSE_ERRORS: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    KeyError,
    TypeError,
    AttributeError,
)
"""Errors that damaged bytes raise in a parser; ValueError includes CRC, Unicode and JSON."""


Span = tuple[int, int]
"""First byte in the file, and the byte after the last."""


class CorruptData(Exception):
    """Error of bytes at `offset` that changed after they were written."""

    def __init__(self, why: str, offset: int) -> None:
        super().__init__(why)
        self.why = why
        self.offset = offset


@dataclass(frozen=True, slots=True)
class ChunkLocation:
    """Location of a chunk in the file: its record begins at `at`, its compressed data is `begin` to `end`."""

    at: int
    begin: int
    end: int
    first_ns: int
    last_ns: int
    size: int
    crc32: int


@dataclass(slots=True)
class McapContent:
    """Records of a log: metadata by name, chunks and the entries of their message indexes."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    chunks: list[ChunkLocation] = field(default_factory=list)
    indexes: list[list[Span]] = field(default_factory=list)
    """Spans of the index entries of each chunk; an entry is log time and offset, eight bytes each."""
    complete: bool = False
    """True if the CRC of the data section matches."""
    closed: bool = False
    """True if the log is complete and has the end of an MCAP file."""
    data_end: int = 0
    """Byte where the data section ends; a closed log has its summary there."""
    trailing_bytes: int = 0
    """Bytes after the end of a closed log; they are not part of it."""
    crc_holds: bool = True
    """False if the data section has a CRC that does not match."""


def iter_records(data: bytes, at: int) -> Iterator[tuple[int, int, memoryview]]:
    """Yield offset, opcode and content of each complete MCAP record in `data` from byte `at` on."""
    view, size = memoryview(data), len(data)
    while at + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        begin = at + RECORD_HEAD.size
        if begin + length > size:
            return
        yield at, opcode, view[begin : begin + length]
        at = begin + length


def parse_chunk(data: bytes, at: int, length: int) -> ChunkLocation:
    """Parse the head of the chunk whose record begins at `at`.

    Raises:
        ValueError: the recorder writes no such chunk.
    """
    head = at + RECORD_HEAD.size
    first_ns, last_ns, size, crc32, name_length, name, packed = CHUNK_HEAD.unpack_from(data, head)
    if name_length != 4 or name != b"zstd" or size > MAX_CHUNK_BYTES or packed != length - CHUNK_HEAD.size:
        raise ValueError(f"a chunk claims {size} bytes, in {packed} of {length}, compressed by {name!r}")
    begin = head + CHUNK_HEAD.size
    return ChunkLocation(at, begin, begin + packed, first_ns, last_ns, size, crc32)


def add_record(found: McapContent, data: bytes, at: int, opcode: int, body: memoryview) -> None:
    """Parse one record and add it to `found`.

    Raises:
        ValueError: a marsarm log has no such record at its top level.
    """
    match opcode:
        case Opcode.CHUNK:
            found.chunks.append(parse_chunk(data, at, len(body)))
            found.indexes.append([])
        case Opcode.METADATA:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
            found.metadata[record.name] = record.metadata
        case Opcode.HEADER if at == len(MCAP0_MAGIC):
            pass
        case Opcode.DATA_END:
            # In MCAP a CRC of 0 means none, but the recorder always writes one.
            crc32 = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
            found.crc_holds = found.complete = crc32 == compute_crc32(data, 0, at)
            end = find_log_end(data, at)
            found.closed = found.complete and end is not None
            found.trailing_bytes = 0 if end is None else len(data) - end
        case _:
            raise ValueError(f"a record with opcode {opcode} and {len(body)} bytes has no place here")


def check_header(path: Path, found: McapContent) -> None:
    """Check that a file is a marsarm log of a known format, and that its header matches its CRC.

    Raises:
        LogNotReadable: it is not, or it ends before its header.
        CorruptData: the header does not match its CRC.
    """
    about = found.metadata.get(FORMAT_RECORD)
    if about is None:
        raise LogNotReadable(path, "an MCAP file, but not a marsarm log, or cut short before its header")
    if problem := version_problem(found.metadata):
        raise LogNotReadable(path, problem)
    if HEADER_RECORD not in found.metadata:
        raise LogNotReadable(path, "cut short before the end of its header; it holds no cycle")
    if header_crc32(found.metadata[HEADER_RECORD]) != about.get("header_crc32"):
        raise CorruptData("the header does not match its CRC", len(MCAP0_MAGIC))


def read_records(path: Path, data: bytes) -> McapContent:
    """Split a file that begins with the magic of MCAP into records; chunks are located, not decompressed.

    Raises:
        LogNotReadable: it is not a marsarm log.
        CorruptData: a record is damaged.
    """
    found, has_header, at = McapContent(data_end=len(MCAP0_MAGIC)), False, 0
    try:
        for at, opcode, body in iter_records(data, len(MCAP0_MAGIC)):
            # Most records are message indexes. The length check excludes a chunk whose opcode lost a bit.
            if (
                opcode == MESSAGE_INDEX
                and has_header
                and len(body) == 6 + ENTRIES_SIZE.unpack_from(body, 2)[0]
            ):
                begin = at + RECORD_HEAD.size
                found.indexes[-1].append((begin + 6, begin + len(body)))
                continue
            if not has_header and opcode not in (Opcode.HEADER, Opcode.METADATA):
                check_header(path, found)
                has_header = True
            add_record(found, data, at, opcode, body)
            if opcode == Opcode.DATA_END:
                found.data_end = at
                return found
            found.data_end = at + RECORD_HEAD.size + len(body)
    except PARSE_ERRORS as error:
        raise CorruptData(str(error) or type(error).__name__, at) from error
    check_header(path, found)
    if data.endswith(MCAP0_MAGIC) and len(data) > len(MCAP0_MAGIC):
        raise CorruptData("it was closed, but a record runs past its end", found.data_end)
    return found


def find_log_end(data: bytes, begin: int) -> int | None:
    """Find the end of the log that contains byte `begin`, after the next magic; None without a magic."""
    found = data.find(MCAP0_MAGIC, begin)
    return None if found < 0 else found + len(MCAP0_MAGIC)


def compute_crc32(data: bytes, begin: int, end: int) -> int:
    """Compute the CRC of a part without copying it."""
    return zlib.crc32(memoryview(data)[begin:end])


def read_summary(data: bytes) -> list[tuple[int, bytes]]:
    """Return opcode and content of the records in the summary of a log; empty if its CRC does not match."""
    at = len(data) - len(MCAP0_MAGIC) - FOOTER_SIZE
    try:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        footer = Footer.read(ReadDataStream(BytesIO(data[at + RECORD_HEAD.size :])))
    except PARSE_ERRORS:
        return []
    begin = footer.summary_start
    is_footer = opcode == Opcode.FOOTER and length == FOOTER_SIZE - RECORD_HEAD.size and 0 < begin <= at
    # The footer's own CRC is its last field.
    if not is_footer or footer.summary_crc != compute_crc32(data, begin, at + FOOTER_SIZE - 4):
        return []
    return [(code, bytes(body)) for _, code, body in iter_records(data[:at], begin)]


def parse_channel(body: bytes | memoryview) -> Channel:
    """Parse a channel record.

    Raises:
        Exception: one of PARSE_ERRORS, if the record is damaged.
    """
    channel: Channel = Channel.read(ReadDataStream(BytesIO(body)))
    return channel
