"""Logs in MCAP, whose records the package mcap reads in the order of the file, with their checksums.

Messages are JSON, or those of ROS 1 and ROS 2 by their definitions.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Any, Final

from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Schema, Statistics
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from simgap.common.errors import RobotError
from simgap.files.message_log import Message, MessageLog, is_wanted, open_messages

Decoder = Callable[[bytes], Any]
DEFINITIONS: Final = {"ros1": ("ros1msg",), "cdr": ("ros2msg", "ros2idl")}
"""Encodings of messages of ROS -> encodings of their definitions."""
IDL_RULE: Final = "=" * 80 + "\nIDL: "
"""Before each definition, in a text with several."""
MAX_BYTES: Final = 1 << 30
"""Largest size of a record, and of an unpacked chunk: writers make chunks of some megabytes, a damaged file
claims any size."""


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
        return open_messages(path, names, topics, messages, start_ns, losses)
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
            file.seek(max(file.seek(0, 2) - len(MCAP0_MAGIC), 0))
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
        raise BadMessage(f"{where} (its head)")
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # lz4 and zstd raise errors of their own
        raise BadMessage(f"{where} ({' '.join(str(error).split()) or type(error).__name__})") from error


def _keep(scan: _Scan, record: McapRecord) -> None:
    """Keep a definition, a channel, or a message of a wanted topic."""
    if isinstance(record, Chunk):
        for one in _open_chunk(record):
            _keep(scan, one)
    elif isinstance(record, DataEnd):
        scan.has_all_data = True
    elif isinstance(record, Statistics) and record.message_count != scan.n_messages:
        raise BadMessage(f"it has {scan.n_messages} messages, its summary says {record.message_count}")
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
            raise BadMessage(f"a message is of channel {record.channel_id}, which is not declared before it")
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
        raise BadMessage(f"the definition of topic {channel.topic!r} is missing")
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


class BadMessage(Exception):
    """A definition, a message or a part of a file cannot be read."""


@lru_cache(maxsize=64)  # Rosbags writes and compiles a program for each definition.
def make_decoder(encoding: str, schema_encoding: str, name: str, definition: bytes) -> Decoder | None:
    """Return the decoder of messages in json, ros1 or cdr, else None; BadMessage for a bad definition."""
    if encoding == "json":
        return _decode_json
    if schema_encoding not in DEFINITIONS.get(encoding, ()):
        return None
    try:
        text = definition.decode()
        store = parse_definition(text, name, is_idl=schema_encoding == "ros2idl")
    except (UnicodeDecodeError, TypesysError, SerdeError, ValueError, LookupError, AttributeError) as error:
        raise BadMessage(f"the definition of {name} cannot be read") from error
    return ros_decoder(store, name, is_ros1=encoding == "ros1")


def parse_definition(text: str, name: str, is_idl: bool = False) -> Typestore:
    """Parse the definition of a type and of those in it."""
    store = get_typestore(Stores.EMPTY)
    if is_idl:
        rule, _, head = IDL_RULE.rpartition("\n")
        parts = text.split(f"{rule}\n")[1:] if text.startswith(IDL_RULE) else [f"{head}\n{text}"]
        for part in parts:
            store.register(get_types_from_idl(part.partition("\n")[2]))
    else:
        store.register(get_types_from_msg(text, _long(name)))
    return store


def ros_decoder(store: Typestore, name: str, is_ros1: bool) -> Decoder:
    """Return the decoder of messages of ROS."""
    kind = _long(name)

    def decode(data: bytes) -> Any:
        try:
            return store.deserialize_ros1(data, kind) if is_ros1 else store.deserialize_cdr(data, kind)
        except (SerdeError, LookupError, ValueError, TypeError, AssertionError) as error:
            raise BadMessage(f"a message of {name} does not fit its definition") from error

    return decode


def _decode_json(data: bytes) -> Any:
    try:
        return json.loads(data)
    except ValueError as error:
        raise BadMessage(f"a message is no JSON: {error}") from error


def _long(name: str) -> str:
    """Return a type with the folder in its middle: a/B is a/msg/B."""
    package, _, kind = name.strip().partition("/")
    return f"{package}/msg/{kind}" if kind and "/" not in kind else name.strip()
