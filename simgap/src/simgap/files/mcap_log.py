"""Logs in MCAP: records in the order of the file, with all checksums compared."""

import mmap
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, McapRecord, Schema, Statistics
from mcap.records import Message as McapMessage
from mcap.stream_reader import breakup_chunk

from simgap.common.errors import RobotError
from simgap.files.decoding import BadMessage, Decoder, make_decoder
from simgap.files.message_log import Message, MessageFile, MessageLog, is_wanted, open_messages

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
"""Before each record: its kind and its length."""
OF_FORMAT: Final = range(0x80)
"""Kinds of records of the format: one that is not known is damage. Above are those of an application."""
MAX_CHUNK_BYTES: Final = 1 << 30
"""Largest size of an unpacked chunk: writers make them of some megabytes, a damaged file claims any."""
CRC_BYTES: Final = 4
"""The checksum of a summary covers all up to itself, at the end of the footer."""


class _Damage(Exception):
    """Damage of a file, in words."""


@dataclass(slots=True)
class _Scan:
    """Records of a file that were read so far."""

    path: Path
    names: Sequence[str] | None
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    decoders: dict[int, Decoder] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    n_messages: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    chunks: set[int] = field(default_factory=set)
    """Offsets of the chunks."""
    indexed: set[int] = field(default_factory=set)
    """Offsets of chunks by their indexes."""
    statistics: Statistics | None = None
    data_end: int | None = None
    """Offset behind the record that ends the data."""
    loss: str = ""
    """Sentence about what is missing at the end; empty if nothing is."""


def open_mcap(path: Path, names: Sequence[str] | None) -> MessageLog:
    """Read fields of an MCAP file, None for all; RobotError if it is damaged or lacks one.

    A file that ends before its data do is used as far as it goes, and the log tells the loss.
    """
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    scans = [_scan_file(one, names) for one in files]
    scans.sort(key=lambda scan: scan.messages[0].time_ns if scan.messages else 0)
    topics = sorted({channel.topic for scan in scans for channel in scan.channels.values()})
    messages = [message for scan in scans for message in scan.messages]
    cut = [scan for scan in scans if scan.loss]
    losses = [one.loss if one.path == path else f"{one.path.name} {one.loss}" for one in cut]
    try:
        start_ns = min((scan.first_ns for scan in scans if scan.first_ns is not None), default=None)
        return open_messages(MessageFile(path, topics, messages, losses, start_ns), names)
    except BadMessage as error:
        raise RobotError(f"{path}: cannot be read: {error}") from error


def _scan_file(path: Path, names: Sequence[str] | None) -> _Scan:
    scan = _Scan(path, names)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        try:
            scan.loss = _scan(scan, data)
        except (_Damage, BadMessage) as error:
            raise RobotError(f"{path}: cannot be read: {error}") from error
    return scan


def _scan(scan: _Scan, data: mmap.mmap) -> str:
    """Read all records and compare the checksums; return a sentence about what is missing at the end."""
    if data[: len(MAGIC)] != MAGIC:
        raise _Damage("it does not begin as an MCAP file does")
    at = len(MAGIC)
    while at + HEAD.size <= len(data):
        kind, length = HEAD.unpack_from(data, at)
        end = at + HEAD.size + length
        if end > len(data):
            break
        if kind == Opcode.FOOTER:
            _check_end(scan, data, at, end)
            return ""
        _read_record(scan, data, at, kind, end)
        at = end
    if data[-len(MAGIC) :] == MAGIC:
        raise _Damage(f"the record at byte {at} has a wrong length")
    if scan.data_end is not None:  # only the index is cut
        return ""
    if scan.first_ns is None:
        raise _Damage("it is cut before its first message")
    used_s = (scan.last_ns - scan.first_ns) * 1e-9
    return (
        f"is cut at byte {len(data)}, where the record of byte {at} is not complete; {used_s:.6g} s are used"
    )


def _read_record(scan: _Scan, data: mmap.mmap, at: int, kind: int, end: int) -> None:
    """Read a record outside of a chunk."""
    stream = ReadDataStream(BytesIO(data[at + HEAD.size : end]))
    try:
        match kind:
            case Opcode.CHUNK:
                scan.chunks.add(at)
                _read_chunk(scan, Chunk.read(stream), at)
            case Opcode.SCHEMA:
                _keep(scan, Schema.read(stream))
            case Opcode.CHANNEL:
                _keep(scan, Channel.read(stream))
            case Opcode.MESSAGE:
                _keep(scan, McapMessage.read(stream, end - at - HEAD.size))
            case Opcode.CHUNK_INDEX:
                scan.indexed.add(ChunkIndex.read(stream).chunk_start_offset)
            case Opcode.STATISTICS:
                scan.statistics = Statistics.read(stream)
            case Opcode.DATA_END:
                crc = DataEnd.read(stream).data_section_crc
                if crc and zlib.crc32(memoryview(data)[:at]) != crc:
                    raise _Damage("its data have another checksum than was written")
                scan.data_end = end
            case _ if kind in OF_FORMAT and kind not in list(Opcode):
                raise _Damage(f"the record at byte {at} is of no known kind")
    except (McapError, ValueError, EOFError, struct.error) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise _Damage(f"the record at byte {at} is damaged ({what})") from error


def _read_chunk(scan: _Scan, chunk: Chunk, at: int) -> None:
    """Read the records of a chunk, after its checksum was compared."""
    where = f"the chunk at byte {at}, which begins at {chunk.message_start_time * 1e-9:.6f} s, "
    if chunk.uncompressed_size > MAX_CHUNK_BYTES or chunk.compression not in ("", "lz4", "zstd"):
        raise _Damage(where + "has a damaged head")
    try:
        records = breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # lz4 and zstd raise errors of their own
        what = " ".join(str(error).split()) or type(error).__name__
        raise _Damage(where + f"is damaged ({what})") from error
    for record in records:
        _keep(scan, record)


def _keep(scan: _Scan, record: McapRecord) -> None:
    """Keep a definition, a channel, or a message of a wanted topic."""
    if isinstance(record, Schema):
        scan.schemas[record.id] = record
    elif isinstance(record, Channel):
        scan.channels[record.id] = record
    elif isinstance(record, McapMessage):
        scan.n_messages += 1
        scan.first_ns = record.log_time if scan.first_ns is None else min(scan.first_ns, record.log_time)
        scan.last_ns = max(scan.last_ns, record.log_time)
        found = scan.channels.get(record.channel_id)
        if found is None:
            raise _Damage(f"a message is of channel {record.channel_id}, which is not declared before it")
        if is_wanted(found.topic, len(record.data), scan.names):
            decode = _decoder(scan, found)
            if decode is not None:
                scan.messages.append(Message(found.topic, record.log_time, partial(decode, record.data)))


def _decoder(scan: _Scan, channel: Channel) -> Decoder | None:
    """Return the decoder of a channel; None for one that a list leaves out."""
    if channel.id in scan.decoders:
        return scan.decoders[channel.id]
    schema = scan.schemas.get(channel.schema_id)
    if channel.schema_id and schema is None:
        raise _Damage(f"the definition of topic {channel.topic!r} is missing")
    form = (schema.encoding, schema.name, schema.data) if schema else ("", "", b"")
    decode = make_decoder(channel.message_encoding, *form)
    if decode is None and scan.names is not None:
        encoding = channel.message_encoding + (f" with {schema.encoding}" if schema else "")
        raise RobotError(
            f"{scan.path}: topic {channel.topic!r} is encoded as {encoding}; write json, or a message of ROS "
            "with its definition"
        )
    if decode is not None:
        scan.decoders[channel.id] = decode
    return decode


def _check_end(scan: _Scan, data: mmap.mmap, at: int, end: int) -> None:
    """Compare the summary with its checksum and with what was read."""
    try:
        footer = Footer.read(ReadDataStream(BytesIO(data[at + HEAD.size : end])))
    except (McapError, EOFError, struct.error) as error:
        raise _Damage("its footer is damaged") from error
    if data[end:] != MAGIC or scan.data_end is None:
        raise _Damage("its end is damaged")
    crc = zlib.crc32(memoryview(data)[scan.data_end : end - CRC_BYTES])
    if footer.summary_crc not in (0, crc):
        raise _Damage("its summary has another checksum than was written")
    meant = scan.n_messages if scan.statistics is None else scan.statistics.message_count
    if meant != scan.n_messages:
        raise _Damage(f"it has {scan.n_messages} messages, its summary says {meant}")
    if not scan.indexed <= scan.chunks:
        raise _Damage(f"the chunk at byte {min(scan.indexed - scan.chunks)} is none")
