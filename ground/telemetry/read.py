"""Reads a log into numpy arrays; what it gives was written, or it says what is wrong."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from ground.telemetry.container import NOT_AS_WRITTEN, ChannelMessages, read_records
from ground.telemetry.errors import LogCorrupt, LogNotReadable
from ground.telemetry.events import CommandEntry, EvrEntry
from ground.telemetry.format import COMMAND_TOPIC, EVR_TOPIC, HEADER_RECORD, LAYOUT_KEY, TICK_NS
from ground.telemetry.schema import Layout


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What a log holds; packets are read-only views of its messages.

    `log["/sensors"]["encoder_count"]` has one row a message, shape (n, 5). A topic that got no message is not
    there. A log cut short by the death of its writer is `truncated`: it holds all chunks that were complete.
    """

    path: Path
    header: Mapping[str, str]
    truncated: bool
    packets: Mapping[str, NDArray[np.void]]
    time_ns: Mapping[str, NDArray[np.uint64]]
    """Log time of each message, shape (n,), by topic; EVRs and commands included."""
    evrs: tuple[EvrEntry, ...]
    commands: tuple[CommandEntry, ...]

    def __getitem__(self, topic: str) -> NDArray[np.void]:
        if topic not in self.packets:
            raise KeyError(f"log {self.path} has no topic {topic}; it has {', '.join(sorted(self.packets))}")
        return self.packets[topic]

    def ticks(self, topic: str) -> NDArray[np.int64]:
        """The cycle of each message of a topic, shape (n,)."""
        return (self.time_ns[topic] // TICK_NS).astype(np.int64)


def times_ns(messages: ChannelMessages) -> NDArray[np.uint64]:
    """Log times, shape (n,); ValueError when a message is missing or out of order."""
    heads = np.array(messages.heads, dtype=np.uint64)
    if not np.array_equal(heads[:, 1], np.arange(len(heads))):
        raise ValueError(f"messages of {messages.channel.topic} are missing or out of order")
    return heads[:, 2].copy()


def packets(messages: ChannelMessages) -> NDArray[np.void]:
    """The messages as one structured array, shape (n,); ValueError when one has not the channel's length."""
    dtype = Layout.from_json(messages.channel.metadata[LAYOUT_KEY]).dtype
    if any(len(body) != dtype.itemsize for body in messages.bodies):
        raise ValueError(f"a message of {messages.channel.topic} is not {dtype.itemsize} bytes long")
    return np.frombuffer(b"".join(messages.bodies), dtype)


def read_log(path: Path | str) -> Log:
    """Read a log, whole or cut short.

    Raises:
        LogNotReadable: there is no such file, or it is not a log of ours.
        LogCorrupt: a CRC, a length or a sequence shows that bytes are not as written.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise LogNotReadable(path, f"cannot be read ({error}); give the path of a log") from error
    if not data.startswith(MCAP0_MAGIC):
        raise LogNotReadable(path, "not an MCAP file" if data else "an empty file; nothing was written to it")
    found = read_records(path, data)
    topics = {one.channel.topic: one for one in found.channels.values() if one.heads}
    arrays = {name: one for name, one in topics.items() if LAYOUT_KEY in one.channel.metadata}
    evrs = topics[EVR_TOPIC].bodies if EVR_TOPIC in topics else []
    commands = topics[COMMAND_TOPIC].bodies if COMMAND_TOPIC in topics else []
    try:
        return Log(
            path=path,
            header=found.metadata[HEADER_RECORD],
            truncated=not found.closed,
            packets={name: packets(one) for name, one in arrays.items()},
            time_ns={name: times_ns(one) for name, one in topics.items()},
            evrs=tuple(map(EvrEntry.decode, evrs)),
            commands=tuple(map(CommandEntry.decode, commands)),
        )
    except NOT_AS_WRITTEN as error:
        raise LogCorrupt(path, str(error), len(data)) from error
