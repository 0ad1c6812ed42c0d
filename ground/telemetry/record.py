"""Writes a run to an MCAP log that survives the death of its writer."""

import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from mcap.writer import Writer

from ground.telemetry.errors import LogNotWritable
from ground.telemetry.events import CommandEntry, Entry, EvrEntry, command_entry, evr_entry
from ground.telemetry.format import (
    CHUNK_S,
    COMMAND_TOPIC,
    EVR_TOPIC,
    FORMAT,
    FORMAT_RECORD,
    HEADER_RECORD,
    LAYOUT_KEY,
    TICK_NS,
    TRUTH_KEY,
    header_crc32,
)
from ground.telemetry.schema import Packer, definition, layout_of
from ground.telemetry.topics import PACKET_TOPICS, Topic
from sim.record import CycleRecord


def open_to_write(path: Path) -> BinaryIO:
    """The open, empty file; LogNotWritable where there can be none."""
    try:
        if path.is_dir():
            raise LogNotWritable(path, "is a directory; give the path of a file, such as run.mcap in it")
        if path.exists() and not path.is_file():
            raise LogNotWritable(path, "is not a regular file; give the path of a new file")
        if not path.parent.is_dir():
            raise LogNotWritable(path, f"directory {path.parent} does not exist; make it, or give another")
        return path.open("wb")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise LogNotWritable(path, f"cannot be written ({why}); give a path that you may write") from error


@dataclass(slots=True)
class _Channel:
    id: int
    count: int = 0


class Recorder:
    """A log being written; a context manager, or call `close`.

    Opening it replaces the file at `path` and writes `header` (versions, digests, seed), before any cycle.
    The messages depend on the records alone; only where a chunk ends depends on the wall clock.

    Raises:
        LogNotWritable: there can be no file at this path; nothing is left behind.
    """

    def __init__(self, path: Path | str, header: Mapping[str, str], chunk_s: float = CHUNK_S) -> None:
        self.path = Path(path)
        self._chunk_s = chunk_s
        existed = os.path.exists(path)  # unlike Path.exists, False for any bad name
        self._file = open_to_write(self.path)
        self._writer = Writer(self._file, enable_data_crcs=True)
        self._channels: dict[str, _Channel] = {}
        self._packers: dict[str, Packer] = {}
        self._chunk_began_s = time.monotonic()
        try:
            self._begin(header)
        except OSError as error:
            with suppress(OSError):
                self._file.close()
            if not existed:
                self.path.unlink()
            why = f"cannot be written ({error.strerror}); give a path with room"
            raise LogNotWritable(self.path, why) from error

    def _begin(self, header: Mapping[str, str]) -> None:
        self._writer.start(profile="", library="marsarm")
        self._writer.add_metadata(FORMAT_RECORD, {"version": FORMAT, "header_crc32": header_crc32(header)})
        self._writer.add_metadata(HEADER_RECORD, dict(header))
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself
        self._add_entry_channel(EVR_TOPIC, EvrEntry)
        self._add_entry_channel(COMMAND_TOPIC, CommandEntry)

    def write(self, record: CycleRecord) -> None:
        """Add one cycle; its messages reach the operating system when the chunk closes.

        Raises:
            SchemaError: a packet is not laid out as in the first cycle, or holds what a log cannot.
            OSError: the disk is full or gone.
        """
        log_time_ns = record.tick * TICK_NS
        for command in record.commands:
            self._add(COMMAND_TOPIC, log_time_ns, command_entry(record.tick, command).encode())
        for topic, packet_of in PACKET_TOPICS:
            packet = packet_of(record)
            if packet is not None:
                packer = self._packers.get(topic.name) or self._add_packet_channel(topic, packet)
                self._add(topic.name, log_time_ns, packer.pack(packet))
        for evr in record.outputs.evrs:
            self._add(EVR_TOPIC, log_time_ns, evr_entry(record.tick, evr).encode())
        if time.monotonic() - self._chunk_began_s >= self._chunk_s:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._chunk_began_s = time.monotonic()

    def close(self) -> None:
        """Write the index and close the file; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add(self, topic: str, log_time_ns: int, message: bytes) -> None:
        channel = self._channels[topic]
        # The sequence counts a channel's messages, so that a reader sees when one is missing.
        self._writer.add_message(channel.id, log_time_ns, message, log_time_ns, channel.count)
        channel.count += 1

    def _add_packet_channel(self, topic: Topic, packet: Any) -> Packer:
        layout = layout_of(packet, topic.field_names)
        metadata = {LAYOUT_KEY: layout.to_json()}
        if topic.is_truth:
            metadata[TRUTH_KEY] = "the plant's own state; flight software never sees it"
        self._add_channel(topic.name, topic.packet, layout.ros_text, metadata)
        self._packers[topic.name] = Packer(topic.packet.__name__, layout)
        return self._packers[topic.name]

    def _add_entry_channel(self, topic: str, entry: type[Entry]) -> None:
        self._add_channel(topic, entry, entry.ros_text(), {})

    def _add_channel(self, topic: str, kind: type, body: str, metadata: dict[str, str]) -> None:
        name = f"marsarm/msg/{kind.__name__}"
        schema_id = self._writer.register_schema(name, "ros2msg", definition(kind.__doc__, body))
        self._channels[topic] = _Channel(self._writer.register_channel(topic, "cdr", schema_id, metadata))
