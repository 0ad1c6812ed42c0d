"""Logs in MCAP, whose records the package mcap reads in the order of the file, with their checksums."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Final

from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Schema, Statistics
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from simgap.common.errors import RobotError
from simgap.files.decoding import BadMessage, Decoder, make_decoder
from simgap.files.message_log import Message, MessageFile, MessageLog, is_wanted, open_messages

MAX_BYTES: Final = 1 << 30
"""Largest size of a record, and of an unpacked chunk: writers make chunks of some megabytes, a damaged file
claims any size."""


class _Damage(Exception):
    """Damage of a file, in words."""


class _WholeReads(BufferedReader):
    """File in which a read of fewer bytes than were asked for is its end."""

    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        if len(found) < (size or 0):
            raise EndOfFile
        return found


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
    has_all_data: bool = False
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
    """Read all records of a file; say what is missing at its end."""
    scan = _Scan(path, names)
    with _WholeReads(FileIO(path)) as file:
        try:
            for record in StreamReader(
                file, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_BYTES
            ).records:
                _keep(scan, record)
        except EndOfFile as error:
            file.seek(-len(MCAP0_MAGIC), 2)
            if file.read() == MCAP0_MAGIC:
                raise RobotError(f"{path}: cannot be read: a record has a wrong length") from error
            if scan.first_ns is None:
                raise RobotError(f"{path}: cannot be read: it is cut before its first message") from error
            used_s = (scan.last_ns - scan.first_ns) * 1e-9
            scan.loss = "" if scan.has_all_data else f"is cut; the first {used_s:.6g} s are used"
        except (RobotError, MemoryError):
            raise
        except Exception as error:  # the package, lz4 and zstd raise errors of any kind
            what = " ".join(str(error).split()) or type(error).__name__
            raise RobotError(f"{path}: cannot be read: {what}") from error
    return scan


def _open_chunk(chunk: Chunk) -> list[McapRecord]:
    """Return the records of a chunk, after its checksum was compared."""
    where = f"the chunk that begins at {chunk.message_start_time * 1e-9:.6f} s is damaged"
    if chunk.uncompressed_size > MAX_BYTES or chunk.compression not in ("", "lz4", "zstd"):
        raise _Damage(f"{where} (its head)")
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # lz4 and zstd raise errors of their own
        raise _Damage(f"{where} ({' '.join(str(error).split()) or type(error).__name__})") from error


def _keep(scan: _Scan, record: McapRecord) -> None:
    """Keep a definition, a channel, or a message of a wanted topic."""
    if isinstance(record, Chunk):
        for one in _open_chunk(record):
            _keep(scan, one)
    elif isinstance(record, DataEnd):
        scan.has_all_data = True
    elif isinstance(record, Statistics) and record.message_count != scan.n_messages:
        raise _Damage(f"it has {scan.n_messages} messages, its summary says {record.message_count}")
    elif isinstance(record, Schema):
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
