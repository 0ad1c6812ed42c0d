"""The container: takes an MCAP log of ours apart and sees that every byte it hands on is as written."""

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
from mcap.records import Channel, Chunk, DataEnd, Metadata
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from ground.telemetry.errors import LogCorrupt, LogNotReadable
from ground.telemetry.format import FORMAT, FORMAT_RECORD, HEADER_RECORD, header_crc32

RECORD_HEAD: Final = struct.Struct("<BQ")
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")

CHUNK_LIMIT: Final = 1 << 28
"""Bytes that a chunk may claim to unpack to; ours have a few hundred thousand at most."""

NOT_AS_WRITTEN: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    KeyError,
    TypeError,
)
"""What broken bytes raise in what takes them apart; ValueError covers CRC, Unicode and JSON."""


@dataclass(slots=True)
class ChannelMessages:
    """The messages of one channel; heads are channel id, sequence, log time, publish time."""

    channel: Channel
    heads: list[tuple[int, ...]] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)


@dataclass(slots=True)
class Content:
    """What was found in a log so far: metadata by name, channels by id, whether it was closed."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    channels: dict[int, ChannelMessages] = field(default_factory=dict)
    closed: bool = False


def records(data: bytes, at: int) -> Iterator[tuple[int, int, bytes]]:
    """Offset, opcode and content of the complete MCAP records in `data` from byte `at`."""
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        begin = at + RECORD_HEAD.size
        if begin + length > len(data):
            return
        yield at, opcode, data[begin : begin + length]
        at = begin + length


def take_chunk(found: Content, body: bytes) -> None:
    """Add a chunk's channels and messages; one of NOT_AS_WRITTEN when its CRC or form is wrong."""
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    size = chunk.uncompressed_size
    # Checked before memory is reserved for it.
    if chunk.compression != "zstd" or size > CHUNK_LIMIT or zstandard.frame_content_size(chunk.data) != size:
        raise ValueError(f"a chunk claims {size} bytes, compressed by {chunk.compression!r}")
    stream, _ = get_chunk_data_stream(chunk, validate_crc=True)
    for _, opcode, inner in records(stream.read(size), 0):
        if opcode == Opcode.MESSAGE:
            head = MESSAGE_HEAD.unpack_from(inner)
            messages = found.channels[head[0]]
            messages.heads.append(head)
            messages.bodies.append(inner[MESSAGE_HEAD.size :])
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(inner)))
            found.channels[channel.id] = ChannelMessages(channel)


def take(found: Content, opcode: int, body: bytes) -> None:
    """Add one record; ValueError for one that a log of ours does not have at its top level."""
    match opcode:
        case Opcode.METADATA:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
            found.metadata[record.name] = record.metadata
        case Opcode.CHUNK:
            take_chunk(found, body)
        case Opcode.HEADER:
            pass
        # The length tells an index from a chunk whose opcode lost a bit.
        case Opcode.MESSAGE_INDEX if len(body) == 6 + int.from_bytes(body[2:6], "little"):
            pass
        case _:
            raise ValueError(f"a record with opcode {opcode} and {len(body)} bytes has no place here")


def check_header(path: Path, found: Content) -> None:
    """See that this is a log of ours, of a format known here, with its header as written."""
    ours = found.metadata.get(FORMAT_RECORD)
    if ours is None:
        raise LogNotReadable(path, "an MCAP file, but not a marsarm log, or cut short before its header")
    if ours.get("version") != FORMAT:
        raise LogNotReadable(path, f"log format {ours.get('version')}; this marsarm reads format {FORMAT}")
    if HEADER_RECORD not in found.metadata:
        raise LogNotReadable(path, "cut short before the end of its header; it holds no cycle")
    if header_crc32(found.metadata[HEADER_RECORD]) != ours.get("header_crc32"):
        raise LogCorrupt(path, "the header does not match its CRC", len(MCAP0_MAGIC))


def read_records(path: Path, data: bytes) -> Content:
    """Read all complete records of a file that begins with MCAP's magic.

    Raises:
        LogNotReadable: it is not a log of ours.
        LogCorrupt: a record is not as written.
    """
    found, offset, headed = Content(), 0, False
    try:
        for at, opcode, body in records(data, len(MCAP0_MAGIC)):
            offset = at
            if not headed and opcode not in (Opcode.HEADER, Opcode.METADATA):
                check_header(path, found)
                headed = True
            if opcode == Opcode.DATA_END:
                if DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc != zlib.crc32(data[:at]):
                    raise ValueError("the data does not match its CRC")
                found.closed = data.endswith(MCAP0_MAGIC)
                return found
            take(found, opcode, body)
    except NOT_AS_WRITTEN as error:
        raise LogCorrupt(path, str(error) or type(error).__name__, offset) from error
    check_header(path, found)
    if data.endswith(MCAP0_MAGIC):
        raise LogCorrupt(path, "it was closed, but a record runs past its end", offset)
    return found
