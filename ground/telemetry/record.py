"""Writes a run to an MCAP log that survives the death of its writer."""

import os
import secrets
from collections.abc import Mapping, Sequence
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self
from weakref import finalize

from mcap.records import Metadata
from numpy.typing import NDArray

from fsw.config import Config
from ground.telemetry.background import Background
from ground.telemetry.catalogue import LOG_LINES, announced, header_text, records_of
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.events import command_entry, evr_entry, log_line
from ground.telemetry.format import (
    CHANNELS_KEY,
    CHUNK_S,
    COMMAND_TOPIC,
    EVR_TOPIC,
    FORMAT,
    FORMAT_RECORD,
    HEADER_RECORD,
    TICK_NS,
    header_crc32,
)
from ground.telemetry.mcap_file import Mark, McapFile, Row
from ground.telemetry.pack import Packer, joined, message_record
from ground.telemetry.standard import EVERY, Sample, Standard, sample_of
from ground.telemetry.topics import PACKET_TOPICS
from sim.record import CycleRecord


def open_to_write(path: Path) -> tuple[FileIO, Path]:
    """An open, empty file beside `path`, without a buffer, and its name.

    It is to take the place of `path` when it has the beginning of a log: what is there stays until then.

    Raises:
        LogNotWritable: there can be no file at this path.
    """
    try:
        if path.is_dir():
            raise LogNotWritable(path, "is a directory; give the path of a file, such as run.mcap in it")
        if path.exists() and not path.is_file():
            raise LogNotWritable(path, "is not a regular file; give the path of a new file")
        if not path.parent.is_dir():
            raise LogNotWritable(path, f"directory {path.parent} does not exist; make it, or give another")
        place = Path(os.path.realpath(path))  # a link stays a link
        if place.exists() and not os.access(place, os.W_OK):
            raise LogNotWritable(
                path, "cannot be written (Permission denied); give a path that you may write"
            )
        part = place.with_name(f".marsarm-{secrets.token_hex(8)}.part")
        return FileIO(part, "xb"), part
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise LogNotWritable(path, f"cannot be written ({why}); give a path that you may write") from error


class Recorder:
    """A log being written; a context manager, or call `close`.

    Opening it replaces the file at `path` and writes `header` (versions, digests, seed) and all channels. The
    messages depend on the records alone; only where a chunk ends depends on the wall clock. With the
    configuration of an arm, the messages that other tools draw it from are there too. A `chunk_s` of 0 is a
    chunk for every cycle.

    Raises:
        LogNotWritable: there can be no file at this path; what was there is still there.
    """

    def __init__(
        self,
        path: Path | str,
        header: Mapping[str, str],
        config: Config | None = None,
        chunk_s: float = CHUNK_S,
    ) -> None:
        self.path = Path(path)
        file, part = open_to_write(self.path)
        channels = announced()
        ids = {one.topic: one.id for one in channels}
        self._packers = [
            (packet_of, Packer(one.topic, one.id, one.layout))
            for one, (_, packet_of) in zip(channels, PACKET_TOPICS, strict=False)
            if one.layout is not None
        ]
        self._event_ids = ids[COMMAND_TOPIC], ids[EVR_TOPIC], ids[LOG_LINES]
        self._event_counts = dict.fromkeys(self._event_ids, 0)
        self._has_standard = config is not None
        log = McapFile(file)
        try:
            header = {**header, CHANNELS_KEY: header_text(channels)}
            about = {"version": FORMAT, "header_crc32": header_crc32(header)}
            log.begin(
                [Metadata(FORMAT_RECORD, about), Metadata(HEADER_RECORD, header)], *records_of(channels)
            )
            os.replace(part, os.path.realpath(self.path))
        except OSError as error:
            file.close()
            part.unlink()
            why = f"cannot be written ({error.strerror}); give another path, with room"
            raise LogNotWritable(self.path, why) from error
        self._background = Background(log, Expander(config, ids), chunk_s)
        self.close = finalize(self, self._background.close)
        """Write what waits and the index, and close the file; a second call does nothing.

        It raises the OSError of a disk that is full or gone. A recorder that is let go closes itself.
        """

    @property
    def written_cycles(self) -> int:
        """The tick after the last cycle that the operating system has; 0 before the first."""
        last_ns = self._background.written_ns
        return 0 if last_ns is None else last_ns // TICK_NS + 1

    def write(self, record: CycleRecord) -> None:
        """Add one cycle; its messages reach the operating system when the chunk closes.

        Raises:
            SchemaError: a packet is not laid out as its schema says, or holds what a log cannot.
            OSError: the disk is full or gone.
        """
        time_ns = record.tick * TICK_NS
        pieces: list[bytes | NDArray[Any]] = []
        present: list[Packer] = []
        length = 0
        for packet_of, packer in self._packers:
            packet = packet_of(record)
            if packet is not None:
                packer.pack(packet, time_ns, pieces)
                present.append(packer)
                length += packer.mark[1]
        data = joined(pieces)
        if len(data) != length:
            self._refuse(record)
        marks = [packer.mark for packer in present]
        if record.commands or record.outputs.evrs:
            data, marks = self._with_events(record, time_ns, data, marks)
        sampled = self._has_standard and record.tick % EVERY == 0
        self._background.put(Row(time_ns, data, marks, sample_of(record) if sampled else None))
        for packer in present:
            packer.count += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _refuse(self, record: CycleRecord) -> NoReturn:
        for packet_of, packer in self._packers:
            packet = packet_of(record)
            if packet is not None:
                packer.check(packet)
        raise AssertionError("a record is longer or shorter than its arrays, each as it should be")

    def _with_events(
        self, record: CycleRecord, time_ns: int, data: bytes, marks: list[Mark]
    ) -> tuple[bytes, list[Mark]]:
        """The commands before the packets, the EVRs and their log lines after them."""
        command_id, evr_id, line_id = self._event_ids
        before = [(command_id, command_entry(record.tick, one).encode()) for one in record.commands]
        after = [
            message
            for evr in record.outputs.evrs
            for message in ((evr_id, evr_entry(record.tick, evr).encode()), (line_id, log_line(time_ns, evr)))
        ]
        counts = dict(self._event_counts)
        parts = [numbered(counts, time_ns, messages) for messages in (before, after)]
        self._event_counts = counts
        (first, first_marks), (last, last_marks) = parts
        return first + data + last, [*first_marks, *marks, *last_marks]


class Expander:
    """Adds to waiting cycles the records of the standard messages."""

    def __init__(self, config: Config | None, ids: Mapping[str, int]) -> None:
        self._standard = None if config is None else Standard(config)
        self._ids = ids
        self._counts = dict.fromkeys(ids.values(), 0)
        self._begun = False

    def __call__(self, rows: Sequence[Row]) -> list[Row]:
        """The same rows, those with a sample followed by what is made of it."""
        expanded = []
        for row in rows:
            expanded.append(row)
            if self._standard is not None and row.sample is not None:
                expanded.append(self._derived(self._standard, row.time_ns, row.sample))
        return expanded

    def _derived(self, standard: Standard, time_ns: int, sample: Sample) -> Row:
        messages = [] if self._begun else list(standard.fixed(time_ns))
        self._begun = True
        messages += standard.sample(time_ns, sample)
        return Row(time_ns, *numbered(self._counts, time_ns, [(self._ids[t], data) for t, data in messages]))


def numbered(
    counts: dict[int, int], time_ns: int, messages: list[tuple[int, bytes]]
) -> tuple[bytes, list[Mark]]:
    """The records of messages by channel, and channel and length of each; counts them."""
    records = []
    for channel, data in messages:
        records.append(message_record(channel, counts[channel], time_ns, data))
        counts[channel] += 1
    marks = [(channel, len(one)) for (channel, _), one in zip(messages, records, strict=True)]
    return b"".join(records), marks
