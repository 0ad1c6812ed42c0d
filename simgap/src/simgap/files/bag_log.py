"""Files of messages: bags of ROS 1 and 2, and MCAP."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_typestore

from simgap.common.errors import RobotError
from simgap.files.mcap_log import BadMessage, Decoder, make_decoder, open_mcap, ros_decoder
from simgap.files.message_log import Message, MessageLog, is_wanted, open_messages

SCHEMAS: Final = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
ROWS: Final = (
    "SELECT topics.name, timestamp FROM messages JOIN topics ON topics.id = topic_id ORDER BY messages.id"
)
"""Topics and times in the order of recording; the reader of rosbags sorts messages by time."""


def open_bag(path: Path, names: Sequence[str] | None) -> MessageLog:
    """Read fields of a bag, a file or a folder of ROS 2, None for all; RobotError if it cannot be read."""
    if any(path.glob("*.mcap")) if path.is_dir() else path.suffix.lower() == ".mcap":
        return open_mcap(path, names)
    try:
        return _read(path, names)
    except (RobotError, MemoryError):
        raise
    except Exception as error:  # damage ends in any error of the readers, and in errors of SQLite
        what = " ".join(str(error).split()) or f"it is damaged ({type(error).__name__})"
        is_part = path.suffix.lower() == ".db3"
        hint = "; name the folder of its bag, after `ros2 bag reindex FOLDER`" if is_part else ""
        raise RobotError(f"{path}: cannot be read: {what}{hint}") from error


def _read(path: Path, names: Sequence[str] | None) -> MessageLog:
    is_ros1 = path.suffix.lower() == ".bag"
    with Reader1(path) if is_ros1 else Reader2(path) as reader:
        decoders = _decoders(path, reader.connections, names, is_ros1)
        chosen = [one for one in reader.connections if one.id in decoders]
        if isinstance(reader, Reader1):
            _check_index(reader)
        _check_times(path, _list_times(reader, chosen))
        messages = (
            Message(one.topic, time_ns, partial(decoders[one.id], bytes(data)))
            for one, time_ns, data in (reader.messages(chosen) if chosen else ())
            if is_wanted(one.topic, len(data), names)
        )
        topics = sorted({one.topic for one in reader.connections})
        return open_messages(path, names, topics, messages, reader.start_time)


def _check_index(reader: Reader1) -> None:
    """Refuse a bag whose index lacks messages of its chunks."""
    meant = sum(sum(chunk.connection_counts.values()) for chunk in reader.chunk_infos)
    n_messages = sum(map(len, reader.indexes.values()))
    if meant != n_messages:
        raise BadMessage(f"its index has {n_messages} messages, its chunks {meant}")


def _list_times(reader: Reader1 | Reader2, chosen: Sequence[Connection]) -> Iterator[tuple[str, int]]:
    """Yield topics and times [ns] in the order of recording, where the bag has it."""
    if isinstance(reader, Reader1):
        for one in chosen:
            rows = sorted(reader.indexes[one.id], key=lambda row: (row.chunk_pos, row.offset))
            yield from ((one.topic, row.time) for row in rows)
        return
    topics = {one.topic for one in chosen}
    for storage in getattr(reader.storage, "storages", [reader.storage]):
        if isinstance(storage, Sqlite3Reader) and storage.dbconn is not None:
            yield from (row for row in storage.dbconn.execute(ROWS) if row[0] in topics)


def _decoders(
    path: Path, connections: Sequence[Connection], names: Sequence[str] | None, is_ros1: bool
) -> dict[int, Decoder]:
    """Return a decoder for each connection of a wanted topic; a list leaves out types that are not known."""
    found: dict[int, Decoder] = {}
    for one in connections:
        if not is_wanted(one.topic, 0, names):
            continue
        decode = _decoder(one, is_ros1)
        if decode is not None:
            found[one.id] = decode
        elif names is not None:
            raise RobotError(
                f"{path}: topic {one.topic!r}: the bag has no definition of {one.msgtype}; record it anew "
                "in MCAP, which has it"
            )
    return found


def _decoder(one: Connection, is_ros1: bool) -> Decoder | None:
    """Return the decoder of a connection; bags of older ROS 2 have no definitions, but known types."""
    if one.msgdef.format in SCHEMAS:
        encoding, schema = ("ros1", "ros1msg") if is_ros1 else ("cdr", SCHEMAS[one.msgdef.format])
        return make_decoder(encoding, schema, one.msgtype, one.msgdef.data.encode())
    store = get_typestore(Stores.LATEST)
    return ros_decoder(store, one.msgtype, is_ros1) if one.msgtype in store.fielddefs else None


def _check_times(path: Path, rows: Iterator[tuple[str, int]]) -> None:
    """Refuse a clock that steps back; rows are topics and times [ns] in the order of recording."""
    last: dict[str, tuple[int, int]] = {}
    for topic, time_ns in rows:
        number, before_ns = last.get(topic, (0, time_ns))
        if time_ns < before_ns:
            raise RobotError(
                f"{path}: topic {topic!r}: the clock steps back by {(before_ns - time_ns) * 1e-9:.6g} s at "
                f"message {number + 1}; cut the file there, into one log a clock"
            )
        last[topic] = number + 1, time_ns
