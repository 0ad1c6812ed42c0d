"""Logs in MCAP: messages in JSON, or in the CDR encoding of ROS 2, as columns with times of their own."""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.columns import Column, check_columns
from simgap.files.ros_message import BadMessage, RosReader

ELEMENT: Final = re.compile(r"\.([A-Za-z_]\w*)|\[(\d+)\]")
Decoder = Callable[[bytes], Any]


@dataclass(frozen=True, slots=True)
class McapLog:
    """Columns of an MCAP file."""

    path: Path
    columns: dict[str, Column]

    def numbers(self, name: str) -> Column:
        """Return the numbers of a field, with the times of its messages."""
        return self.columns[name]

    def texts(self, name: str) -> NDArray[np.str_]:
        """Refuse: messages have no rows that a text could divide."""
        raise RobotError(
            f"{self.path}: {name!r}: a log in MCAP is one motion; leave out the columns of [motion]"
        )


def open_mcap(path: Path, names: Sequence[str]) -> McapLog:
    """Read fields of an MCAP file.

    Args:
        names: Fields, as topic and path in its messages: `/joint_states.position[2]`.

    Raises:
        RobotError: the file is damaged, a field is missing, or its encoding is unknown.
    """
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            topics = sorted({one.topic for one in summary.channels.values()}) if summary else []
            fields = {name: _split(path, name, topics) for name in dict.fromkeys(names)}
            found = _collect(path, reader.iter_messages({topic for topic, _ in fields.values()}), fields)
    except (McapError, BadMessage, EOFError, ValueError) as error:
        raise RobotError(f"{path}: cannot be read: {str(error) or 'it is cut short'}") from error
    except RecursionError as error:
        raise RobotError(f"{path}: a message is nested too deeply; write fields of a few levels") from error
    start_ns = min((times[0] for times, _ in found.values() if times), default=0)
    return McapLog(path, {name: _column(path, name, *one, start_ns) for name, one in found.items()})


def _split(path: Path, name: str, topics: Sequence[str]) -> tuple[str, tuple[str | int, ...]]:
    """Divide a name into its topic, the longest that fits, and the path of its field."""
    topic = max((one for one in topics if name.startswith(one + ".")), key=len, default="")
    if not topic:
        check_columns(path, [name.partition(".")[0]], topics)
    rest = name.removeprefix(topic)
    parts = ELEMENT.findall(rest)
    if "".join(f".{key}" if key else f"[{index}]" for key, index in parts) != rest or not parts:
        raise RobotError(
            f"{path}: {name!r} is no field; write a topic and a field, such as /joints.position[0]"
        )
    return topic, tuple(key or int(index) for key, index in parts)


Messages = Iterator[tuple[Schema | None, Channel, Any]]
Found = dict[str, tuple[list[int], list[float]]]


def _collect(path: Path, messages: Any, fields: dict[str, tuple[str, tuple[str | int, ...]]]) -> Found:
    """Take the fields out of the messages, in their order of time."""
    found: Found = {name: ([], []) for name in fields}
    decoders: dict[int, Decoder] = {}
    for schema, channel, message in messages:
        decode = decoders.setdefault(channel.id, _decoder(path, schema, channel))
        content = decode(message.data)
        for name, (topic, place) in fields.items():
            if topic == channel.topic:
                times, values = found[name]
                times.append(message.log_time)
                values.append(_number(path, name, content, place))
    return found


def _decoder(path: Path, schema: Schema | None, channel: Channel) -> Decoder:
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        return RosReader(schema.name, schema.data.decode()).read
    encoding = channel.message_encoding + (f" with {schema.encoding}" if schema else "")
    raise RobotError(
        f"{path}: topic {channel.topic!r} is encoded as {encoding}; write json, or cdr with ros2msg"
    )


def _number(path: Path, name: str, content: Any, place: Sequence[str | int]) -> float:
    """Return the number at a place of a message; a stamp of ROS is a number of seconds."""
    for key in place:
        try:
            content = content[key]
        except (KeyError, IndexError, TypeError):
            there = f"has {', '.join(content)}" if isinstance(content, dict) else "is not so long"
            raise RobotError(f"{path}: {name!r}: there is no {key!r} in a message, which {there}") from None
    if isinstance(content, dict) and "sec" in content:
        nanoseconds = content.get("nanosec", content.get("nsec", 0))
        return _float(path, name, content["sec"]) + 1e-9 * _float(path, name, nanoseconds)
    return _float(path, name, content)


def _float(path: Path, name: str, value: Any) -> float:
    """Return a value as a number; null is none."""
    if value is None:
        return math.nan
    if not isinstance(value, int | float):
        raise RobotError(f"{path}: {name!r} has {type(value).__name__}; name a number in it")
    try:
        return float(value)
    except OverflowError:  # an integer of hundreds of digits
        return math.inf


def _column(path: Path, name: str, times_ns: list[int], values: list[float], start_ns: int) -> Column:
    if not values:
        raise RobotError(f"{path}: {name!r} has no messages; name a topic that was recorded")
    time_s: Array = np.array([time - start_ns for time in times_ns], dtype=np.float64) * 1e-9
    return Column(np.array(values, dtype=np.float64), None, time_s)
