"""The container: takes an MCAP log of ours apart and sees that its records are as written."""

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

from ground.telemetry.errors import LogNotReadable
from ground.telemetry.format import FORMAT, FORMAT_RECORD, HEADER_RECORD, header_crc32

RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQII4sQ")
"""First and last log time, size and CRC unpacked, length and name of the compression, length of the data."""

FOOTER_SIZE: Final = RECORD_HEAD.size + 8 + 8 + 4

MESSAGE_INDEX: Final = int(Opcode.MESSAGE_INDEX)
"""As a plain number: most records of a log are such, and an enum takes its time."""

ENTRIES_SIZE: Final = struct.Struct("<I")

MAX_CHUNK_BYTES: Final = 1 << 26
"""Bytes that a chunk may claim to unpack to; ours have a million at most."""

MAX_UNPACKED_BYTES: Final = 1 << 33
"""Bytes that are unpacked at once: a day of telemetry. Zeros pack so well that a file claims any number."""

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
"""What broken bytes raise in what takes them apart; ValueError covers CRC, Unicode and JSON."""


Span = tuple[int, int]
"""Where something begins and ends in the file."""


class CorruptData(Exception):
    """The bytes at `offset` are not those that were written."""

    def __init__(self, why: str, offset: int) -> None:
        super().__init__(why)
        self.why = why
        self.offset = offset


@dataclass(frozen=True, slots=True)
class ChunkLocation:
    """A chunk in the file: its record begins at `at`, its compressed data is `begin` to `end`."""

    at: int
    begin: int
    end: int
    first_ns: int
    last_ns: int
    size: int
    crc32: int


@dataclass(slots=True)
class McapContent:
    """What a log consists of: metadata by name, chunks and the entries of their message indexes."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    chunks: list[ChunkLocation] = field(default_factory=list)
    indexes: list[list[Span]] = field(default_factory=list)
    """For each chunk, by channel: where log time and offset of each message stand, eight bytes each."""
    complete: bool = False
    """The CRC of all that the run wrote holds."""
    closed: bool = False
    """Complete, and ended as MCAP files end."""
    data_end: int = 0
    """Where the records of the run end; a closed log has its summary there."""
    behind: int = 0
    """Bytes behind the end of a closed log, which are no part of it."""
    crc_holds: bool = True
    """False where the run ends with another CRC than its bytes have."""


def iter_records(data: bytes, at: int) -> Iterator[tuple[int, int, memoryview]]:
    """Offset, opcode and content of the complete MCAP records in `data` from byte `at`."""
    view, size = memoryview(data), len(data)
    while at + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        begin = at + RECORD_HEAD.size
        if begin + length > size:
            return
        yield at, opcode, view[begin : begin + length]
        at = begin + length


def parse_chunk(data: bytes, at: int, length: int) -> ChunkLocation:
    """The chunk whose record begins at `at`; ValueError for what no chunk of ours says of itself."""
    head = at + RECORD_HEAD.size
    first_ns, last_ns, size, crc32, name_length, name, packed = CHUNK_HEAD.unpack_from(data, head)
    if name_length != 4 or name != b"zstd" or size > MAX_CHUNK_BYTES or packed != length - CHUNK_HEAD.size:
        raise ValueError(f"a chunk claims {size} bytes, in {packed} of {length}, compressed by {name!r}")
    begin = head + CHUNK_HEAD.size
    return ChunkLocation(at, begin, begin + packed, first_ns, last_ns, size, crc32)


def add_record(found: McapContent, data: bytes, at: int, opcode: int, body: memoryview) -> None:
    """Add one record; ValueError for one that a log of ours does not have at its top level."""
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
            # A CRC of zero is MCAP's word for none, but ours always have one.
            crc32 = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
            found.crc_holds = found.complete = crc32 == compute_crc32(data, 0, at)
            end = find_log_end(data, at)
            found.closed = found.complete and end is not None
            found.behind = 0 if end is None else len(data) - end
        case _:
            raise ValueError(f"a record with opcode {opcode} and {len(body)} bytes has no place here")


def check_header(path: Path, found: McapContent) -> None:
    """See that this is a log of ours, of a format known here, with its header as written."""
    ours = found.metadata.get(FORMAT_RECORD)
    if ours is None:
        raise LogNotReadable(path, "an MCAP file, but not a marsarm log, or cut short before its header")
    if ours.get("version") != FORMAT:
        raise LogNotReadable(path, f"log format {ours.get('version')}; this marsarm reads format {FORMAT}")
    if HEADER_RECORD not in found.metadata:
        raise LogNotReadable(path, "cut short before the end of its header; it holds no cycle")
    if header_crc32(found.metadata[HEADER_RECORD]) != ours.get("header_crc32"):
        raise CorruptData("the header does not match its CRC", len(MCAP0_MAGIC))


def read_records(path: Path, data: bytes) -> McapContent:
    """Take apart a file that begins with MCAP's magic; chunks are found, not yet unpacked.

    Raises:
        LogNotReadable: it is not a log of ours.
        NotAsWritten: a record is not as written.
    """
    found, headed, at = McapContent(data_end=len(MCAP0_MAGIC)), False, 0
    try:
        for at, opcode, body in iter_records(data, len(MCAP0_MAGIC)):
            # Most records are such, so they come first; the length tells one from a chunk that lost a bit.
            if opcode == MESSAGE_INDEX and headed and len(body) == 6 + ENTRIES_SIZE.unpack_from(body, 2)[0]:
                begin = at + RECORD_HEAD.size
                found.indexes[-1].append((begin + 6, begin + len(body)))
                continue
            if not headed and opcode not in (Opcode.HEADER, Opcode.METADATA):
                check_header(path, found)
                headed = True
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
    """Where the log ends that `begin` is in: behind the next magic; None where there is none."""
    found = data.find(MCAP0_MAGIC, begin)
    return None if found < 0 else found + len(MCAP0_MAGIC)


def compute_crc32(data: bytes, begin: int, end: int) -> int:
    """The CRC of a part, without a copy."""
    return zlib.crc32(memoryview(data)[begin:end])


def read_summary(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and content of the records in a closed log's summary; nothing where its CRC does not hold."""
    at = len(data) - len(MCAP0_MAGIC) - FOOTER_SIZE
    try:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        footer = Footer.read(ReadDataStream(BytesIO(data[at + RECORD_HEAD.size :])))
    except PARSE_ERRORS:
        return []
    begin = footer.summary_start
    whole = opcode == Opcode.FOOTER and length == FOOTER_SIZE - RECORD_HEAD.size and 0 < begin <= at
    # The footer's own CRC is its last field.
    if not whole or footer.summary_crc != compute_crc32(data, begin, at + FOOTER_SIZE - 4):
        return []
    return [(code, bytes(body)) for _, code, body in iter_records(data[:at], begin)]


def parse_channel(body: bytes | memoryview) -> Channel:
    """A channel record; one of NOT_AS_WRITTEN where it is none."""
    channel: Channel = Channel.read(ReadDataStream(BytesIO(body)))
    return channel
