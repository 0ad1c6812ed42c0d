"""Recorder of a run into an MCAP log that stays readable if the run is killed, and creation of the file."""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fcntl import F_DUPFD_CLOEXEC, fcntl
from io import FileIO
from itertools import compress
from operator import add, attrgetter
from pathlib import Path
from types import TracebackType
from typing import Final, Self
from weakref import finalize

from mcap.records import Metadata

from fsw.config import Config
from marsarm.telemetry.errors import LogNotWritable
from marsarm.telemetry.events import command_entry, evr_entry, rosout_message
from marsarm.telemetry.format import (
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
from marsarm.telemetry.mcap_writer import McapState, McapWriter
from marsarm.telemetry.pack import Packer, PacketSource, number_messages
from marsarm.telemetry.robot_description import DrawnScene
from marsarm.telemetry.ros_messages import SAMPLE_CYCLES, RosEncoder, joint_sample
from marsarm.telemetry.schema import arm_names
from marsarm.telemetry.topic_specs import ROSOUT_TOPIC, TopicSpec, encode_topics, mcap_records, topic_specs
from marsarm.telemetry.topics import PACKET_TOPICS
from marsarm.telemetry.writer_pipe import WriterPipe
from sim.params import nominal_params
from sim.record import CycleRecord
from simgap.common.files import atomic_path, lock_file
from simgap.common.interruption import describe_interruption

NOT_CLOSED: Final = "a recorder that nobody closed"
"""Cause of an interruption if the program ended without an exception that it could report."""


@contextmanager
def create_log(
    path: Path, header: Mapping[str, str], channels: tuple[TopicSpec, ...]
) -> Iterator[tuple[FileIO, McapState]]:
    """Create a log with header and channels, open for a block.

    At the end of the block the new file replaces the file at `path`. After an error the new file is deleted.

    Raises:
        LogNotWritable: the file cannot be written, or the disk is full; a previous file is unchanged.
    """
    target = _resolve_path(path)
    try:
        with atomic_path(target) as part, FileIO(part, "xb", opener=_open_above_stdio) as file:
            lock_file(file.fileno())  # it is new; the lock lasts until the log is complete
            yield file, _write_header(file, header, channels)
    except OSError as error:
        why = f"cannot be written ({error.strerror}); give a path with room that you may write"
        raise LogNotWritable(path, why) from error


def _open_above_stdio(path: str, flags: int) -> int:
    """Open a file with a descriptor above 2: a new process would take a lower one for its standard stream."""
    descriptor = os.open(path, flags, 0o666)
    try:
        return fcntl(descriptor, F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(descriptor)


def _resolve_path(path: Path) -> Path:
    """Return the path with links resolved.

    Raises:
        LogNotWritable: no file can be written there.
    """
    try:
        if path.is_dir():
            raise LogNotWritable(path, "is a directory; give the path of a file, such as run.mcap in it")
        exists = path.exists()
        if exists and not path.is_file():
            raise LogNotWritable(path, "is not a regular file; give the path of a new file")
        if not path.parent.is_dir():
            raise LogNotWritable(path, f"directory {path.parent} does not exist; make it, or give another")
        if exists and not os.access(path, os.W_OK):
            raise LogNotWritable(path, "is there and you may not write it; give the path of a new file")
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise LogNotWritable(path, f"cannot be written ({why}); give a path that you may write") from error


def _write_header(file: FileIO, header: Mapping[str, str], channels: tuple[TopicSpec, ...]) -> McapState:
    log = McapWriter(file)
    header = {**header, CHANNELS_KEY: encode_topics(channels)}
    about = {"version": FORMAT, "header_crc32": header_crc32(header)}
    log.begin([Metadata(FORMAT_RECORD, about), Metadata(HEADER_RECORD, header)], *mcap_records(channels))
    return log.written


class Recorder:
    """Log being written; a context manager, or call `close`.

    The messages depend only on the records of the cycles. The ends of the chunks depend on the wall clock.
    """

    def __init__(
        self,
        path: Path | str,
        header: Mapping[str, str],
        config: Config | None = None,
        chunk_s: float = CHUNK_S,
        scene: DrawnScene | None = None,
    ) -> None:
        """Replace the file at `path` by a log with header and channels.

        Args:
            path: File.
            header: Versions, digests, seed and more, as `run_header` returns them.
            config: Configuration of the arm, to record messages for other tools too; None for none.
            chunk_s: Wall time of a chunk; 0 for one chunk each cycle.
            scene: Visible shapes of the run, which viewers draw; None for none. It needs `config`.

        Raises:
            LogNotWritable: no log can be written at this path; a previous file is unchanged.
        """
        self.path = Path(path)
        channels = topic_specs(arm_names(nominal_params() if config is None else config.params))
        ids = {one.topic: one.id for one in channels}
        self._sources = [
            PacketSource(topic.path, one.id, one.layout)
            for one, (topic, _) in zip(channels, PACKET_TOPICS, strict=False)
            if one.layout is not None
        ]
        self._packets = attrgetter(*[source.path for source in self._sources])
        self._packers: dict[tuple[bool, ...], Packer] = {}
        self._counts = [0] * len(self._sources)
        self._event_ids = ids[COMMAND_TOPIC], ids[EVR_TOPIC], ids[ROSOUT_TOPIC]
        self._event_counts = dict.fromkeys(self._event_ids, 0)
        self._has_ros_messages = config is not None
        self._last_tick = -1
        encoder = None if config is None else RosEncoder(config, scene)
        with create_log(self.path, header, channels) as (file, written):
            try:
                self._pipe = WriterPipe(file, written, ids, encoder, chunk_s)
            except OSError as error:
                why = f"has no process to write it ({error.strerror}); see that {sys.executable} starts"
                raise LogNotWritable(self.path, why) from error
            # A recorder without references closes itself, for nobody can say any more that the run is done.
            self._finalizer = finalize(self, self._pipe.close, NOT_CLOSED)

    @property
    def writer_process(self) -> int:
        """Id of the process that writes the log."""
        return self._pipe.process

    @property
    def written_cycles(self) -> int:
        """Tick after the last cycle in the log; known after `close` or an error, 0 without a cycle."""
        last_ns = self._pipe.written_ns
        return 0 if last_ns is None else last_ns // TICK_NS + 1

    def write(self, record: CycleRecord) -> None:
        """Add one cycle; the operating system receives its messages when the chunk closes.

        Raises:
            SchemaError: a packet differs from its layout, or a value cannot be recorded.
            OSError: the disk is full or gone.
            ValueError: the log is closed, the tick does not rise, or an earlier write was interrupted.
        """
        if record.tick <= self._last_tick:
            raise ValueError(f"cycle {record.tick} after cycle {self._last_tick}: a log goes forward")
        time_ns = record.tick * TICK_NS
        present = tuple([packet is not None for packet in self._packets(record)])
        packer = self._packers.get(present) or self._packer(present)
        data = packer.pack(record, time_ns, [*compress(self._counts, present)])
        if record.commands or record.outputs.evrs:
            data = self._with_events(record, time_ns, data)
        sampled = self._has_ros_messages and record.tick % SAMPLE_CYCLES == 0
        self._pipe.put(time_ns, data, joint_sample(record) if sampled else None)
        self._last_tick = record.tick
        self._counts = [*map(add, self._counts, present)]

    def close(self, interrupted_by: str = "") -> None:
        """Write the waiting cycles and the summary, and close the file; a second call does nothing.

        Args:
            interrupted_by: Cause if the run was interrupted, which the log then says; empty if it was not.

        Raises:
            OSError: the disk is full or gone.
        """
        if self._finalizer.detach() is not None:
            self._pipe.close(interrupted_by)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close("" if error is None else describe_interruption(error))

    def _packer(self, present: tuple[bool, ...]) -> Packer:
        """Return the packer of cycles in which these packets are present."""
        return self._packers.setdefault(present, Packer([*compress(self._sources, present)]))

    def _with_events(self, record: CycleRecord, time_ns: int, data: bytes) -> bytes:
        """Put the commands before the packets, and the EVRs with their ROS messages after them."""
        command_id, evr_id, rosout_id = self._event_ids
        before = [(command_id, command_entry(record.tick, one).encode()) for one in record.commands]
        after = [
            message
            for evr in record.outputs.evrs
            for message in (
                (evr_id, evr_entry(record.tick, evr).encode()),
                (rosout_id, rosout_message(time_ns, evr)),
            )
        ]
        counts = dict(self._event_counts)
        first, last = (number_messages(counts, time_ns, messages) for messages in (before, after))
        self._event_counts = counts
        return first + data + last
