"""Writes a run to an MCAP log that survives the death of its writer."""

import sys
from collections.abc import Mapping
from itertools import compress
from operator import add, attrgetter
from pathlib import Path
from types import TracebackType
from typing import Self
from weakref import finalize

from fsw.config import Config
from ground.telemetry.catalogue import LOG_LINES, all_channels
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.events import command_entry, evr_entry, log_line
from ground.telemetry.format import CHUNK_S, COMMAND_TOPIC, EVR_TOPIC, TICK_NS
from ground.telemetry.handover import Handover
from ground.telemetry.opening import begun
from ground.telemetry.pack import Packer, Source, numbered
from ground.telemetry.standard import EVERY, sample_of
from ground.telemetry.topics import PACKET_TOPICS
from sim.record import CycleRecord


class Recorder:
    """A log being written; a context manager, or call `close`.

    Opening it replaces the file at `path` by `header` (versions, digests, seed) and all channels, once they
    are written. The messages depend on the records alone; only where a chunk ends depends on the wall clock.
    With the configuration of an arm, the messages that other tools draw it from are there too. A `chunk_s` of
    0 is a chunk for every cycle.

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
        channels = all_channels()
        ids = {one.topic: one.id for one in channels}
        self._sources = [
            Source(topic.path, one.id, one.layout)
            for one, (topic, _) in zip(channels, PACKET_TOPICS, strict=False)
            if one.layout is not None
        ]
        self._packets = attrgetter(*[source.path for source in self._sources])
        self._packers: dict[tuple[bool, ...], Packer] = {}
        self._counts = [0] * len(self._sources)
        self._event_ids = ids[COMMAND_TOPIC], ids[EVR_TOPIC], ids[LOG_LINES]
        self._event_counts = dict.fromkeys(self._event_ids, 0)
        self._has_standard = config is not None
        self._last_tick = -1
        with begun(self.path, header, channels) as (file, written):
            try:
                self._handover = Handover(file, written, ids, config, chunk_s)
            except OSError as error:
                why = f"has no process to write it ({error.strerror}); see that {sys.executable} starts"
                raise LogNotWritable(self.path, why) from error
            self.close = finalize(self, self._handover.close)
            """Write what waits and the index, and close the file; a second call does nothing.

            It raises the OSError of a disk that is full or gone. A recorder that is let go closes itself.
            """

    @property
    def writer_process(self) -> int:
        """Number of the process that writes the log."""
        return self._handover.process

    @property
    def written_cycles(self) -> int:
        """The tick after the last cycle in the log, once it is closed or has failed; 0 if there is none."""
        last_ns = self._handover.written_ns
        return 0 if last_ns is None else last_ns // TICK_NS + 1

    def write(self, record: CycleRecord) -> None:
        """Add one cycle; its messages reach the operating system when the chunk closes.

        Raises:
            SchemaError: a packet is not laid out as its schema says, or holds what a log cannot.
            OSError: the disk is full or gone.
            ValueError: the log is closed, or goes back, or a cycle before was interrupted on its way.
        """
        if record.tick <= self._last_tick:
            raise ValueError(f"cycle {record.tick} after cycle {self._last_tick}: a log goes forward")
        time_ns = record.tick * TICK_NS
        present = tuple([packet is not None for packet in self._packets(record)])
        packer = self._packers.get(present) or self._packer(present)
        data = packer.pack(record, time_ns, [*compress(self._counts, present)])
        if record.commands or record.outputs.evrs:
            data = self._with_events(record, time_ns, data)
        sampled = self._has_standard and record.tick % EVERY == 0
        self._handover.put(time_ns, data, sample_of(record) if sampled else None)
        self._last_tick = record.tick
        self._counts = [*map(add, self._counts, present)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _packer(self, present: tuple[bool, ...]) -> Packer:
        """What packs the packets that these cycles have."""
        return self._packers.setdefault(present, Packer([*compress(self._sources, present)]))

    def _with_events(self, record: CycleRecord, time_ns: int, data: bytes) -> bytes:
        """The commands before the packets, the EVRs and their log lines after them."""
        command_id, evr_id, line_id = self._event_ids
        before = [(command_id, command_entry(record.tick, one).encode()) for one in record.commands]
        after = [
            message
            for evr in record.outputs.evrs
            for message in ((evr_id, evr_entry(record.tick, evr).encode()), (line_id, log_line(time_ns, evr)))
        ]
        counts = dict(self._event_counts)
        first, last = (numbered(counts, time_ns, messages) for messages in (before, after))
        self._event_counts = counts
        return first + data + last
