"""Writes what can be saved of a damaged log into a whole one."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel
from mcap.writer import Writer

from ground.outputs import BadOutput, check_output, written_whole
from ground.telemetry.chunks import HEAD, MESSAGE_HEAD
from ground.telemetry.errors import LogNotReadable
from ground.telemetry.format import FORMAT, FORMAT_RECORD, HEADER_RECORD, header_crc32
from ground.telemetry.loss import RECOVERED_RECORD, Lost, recovered_record
from ground.telemetry.messages import layouts_of
from ground.telemetry.read import bytes_of, log_from
from ground.telemetry.salvage import Salvage, Saved, salvage

Progress = Callable[[float, float, str], None]


@dataclass(frozen=True, slots=True)
class Recovered:
    """What came of a recovery."""

    saved: Mapping[str, int]
    """Messages by topic."""
    lost: tuple[Lost, ...]
    """Of this recovery and of those before it."""
    header_lost: bool
    """Whether versions, parameters and commands of the run are gone."""


def recover(bad: Path, good: Path, progress: Progress) -> Recovered:
    """Read what is undamaged in `bad` and write it to `good` as a whole log.

    Messages are counted anew, so that the new log is complete in itself; a record of its own says what was
    lost. `good` appears only when it is whole and reads back.

    Raises:
        LogNotReadable: `bad` cannot be read, or holds nothing of a marsarm log.
        LogDamaged: what is undamaged does not make a log.
        BadOutput: `good` cannot be written.
    """
    data = bytes_of(bad)
    _check_apart(bad, check_output(good, (".mcap",), "GOOD"))
    progress(0, 1, "searching")
    found = salvage(data)
    _check_ours(bad, found)
    lost = (*found.lost_before, *found.lost)
    with written_whole(good, "GOOD") as file:
        saved = _write(file, found, lost, progress)
        file.flush()
        log_from(bad, Path(file.name).read_bytes())
    return Recovered(saved, lost, HEADER_RECORD not in found.metadata)


def _check_apart(bad: Path, good: Path) -> None:
    if good.exists() and os.path.samefile(bad, good):
        raise BadOutput(f"GOOD {good}: is the damaged log itself; give the path of a new file")


def _check_ours(bad: Path, found: Salvage) -> None:
    version = found.metadata.get(FORMAT_RECORD, {}).get("version", FORMAT)
    if version != FORMAT:
        raise LogNotReadable(bad, f"log format {version}; this marsarm reads format {FORMAT}")
    if not found.chunks and HEADER_RECORD not in found.metadata:
        raise LogNotReadable(bad, "holds no undamaged part of a marsarm log; nothing can be saved")
    if found.chunks and not set(layouts_of(found.metadata.get(HEADER_RECORD, {}), found.channels)):
        raise LogNotReadable(bad, "nothing in it says what its messages mean; nothing can be saved")


def _write(file: BinaryIO, found: Salvage, lost: tuple[Lost, ...], progress: Progress) -> dict[str, int]:
    """Write all that was found; messages by topic."""
    header = dict(found.metadata.get(HEADER_RECORD, {}))
    writer = Writer(file, chunk_size=1 << 30, enable_data_crcs=True)
    writer.start(profile="", library="marsarm")
    writer.add_metadata(FORMAT_RECORD, {"version": FORMAT, "header_crc32": header_crc32(header)})
    writer.add_metadata(HEADER_RECORD, header)
    writer.add_metadata(RECOVERED_RECORD, recovered_record(lost))
    copy = _Copy(writer, found)
    for k, chunk in enumerate(found.chunks):
        copy.chunk(chunk)
        progress(k, len(found.chunks), "writing")
    writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself
    return {found.channels[number].topic: count for number, count in copy.counts.items()}


class _Copy:
    """Puts chunks into a new file; it declares a channel before its first message."""

    def __init__(self, writer: Writer, found: Salvage) -> None:
        self._writer = writer
        self._found = found
        self._schemas: dict[int, int] = {}
        self._channels: dict[int, int] = {}
        self._next: dict[int, int] = {}
        self.counts: dict[int, int] = {}

    def chunk(self, chunk: Saved) -> None:
        """Add the messages of known channels, in a chunk of their own."""
        for start, head in zip(chunk.starts, chunk.heads.tolist(), strict=True):
            _, length, number, sequence, time_ns, publish_ns = head
            # A message that was there before is a piece of the file that was written twice.
            if number not in self._found.channels or sequence < self._next.get(number, 0):
                continue
            begin = start + HEAD.itemsize
            message = chunk.plain[begin : begin + length - MESSAGE_HEAD]
            count = self.counts.get(number, 0)
            self._writer.add_message(self._channel(number), time_ns, message, publish_ns, count)
            self.counts[number], self._next[number] = count + 1, sequence + 1
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _channel(self, number: int) -> int:
        if number not in self._channels:
            channel: Channel = self._found.channels[number]
            schema = self._schema(channel.schema_id)
            self._channels[number] = self._writer.register_channel(
                channel.topic, channel.message_encoding, schema, channel.metadata
            )
        return self._channels[number]

    def _schema(self, number: int) -> int:
        """The schema in the new file; 0, MCAP's word for none, where it is lost."""
        if number not in self._schemas:
            schema = self._found.schemas.get(number)
            self._schemas[number] = (
                0
                if schema is None
                else self._writer.register_schema(schema.name, schema.encoding, schema.data)
            )
        return self._schemas[number]
