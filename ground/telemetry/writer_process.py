"""The process that writes a log: takes rows from standard input and writes them, chunk by chunk.

It goes on for as long as rows may come. A run that ends without closing its log, whatever ended it, loses
nothing that it has handed over; its log is cut short. Interrupts are for the run; they are kept from here.
"""

import errno
import json
import os
import pickle
import struct
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from io import BufferedReader, FileIO
from typing import Final, Protocol

from fsw.config import Config
from ground.telemetry.format import CHUNK_S
from ground.telemetry.mcap_writer import LogRow, McapState, McapWriter
from ground.telemetry.pack import number_messages
from ground.telemetry.ros_messages import JointSample, RosEncoder


class Expander:
    """Adds the records of the standard messages of one arm; without a configuration there are none."""

    def __init__(self, config: Config | None, ids: Mapping[str, int]) -> None:
        self._standard = None if config is None else RosEncoder(config)
        self._ids = ids
        self._counts = dict.fromkeys(ids.values(), 0)
        self._begun = False

    def __call__(self, rows: Sequence[tuple[LogRow, JointSample | None]]) -> list[LogRow]:
        """The same rows, those with a sample followed by what is made of it."""
        expanded = []
        for row, sample in rows:
            expanded.append(row)
            if self._standard is not None and sample is not None:
                expanded.append(self._derived(self._standard, row.time_ns, sample))
        return expanded

    def _derived(self, standard: RosEncoder, time_ns: int, sample: JointSample) -> LogRow:
        messages = [] if self._begun else list(standard.fixed(time_ns))
        self._begun = True
        messages += standard.sample(time_ns, sample)
        return LogRow(
            time_ns, number_messages(self._counts, time_ns, [(self._ids[t], data) for t, data in messages])
        )


ROW_HEAD: Final = struct.Struct("<QII")
"""Before each row: time [ns], length of its records, length of its sample or 0."""
READY: Final = b"ready for rows\n"
"""The line that it says when it can take them."""
END: Final = ROW_HEAD.pack(0, 0, 0)
"""A row of nothing: the log is complete."""
PIPE_BYTES: Final = 1 << 20
"""What may wait: seconds of a run that keeps pace with the clock."""
MAX_ROWS: Final = 1024
"""In one chunk; it has about 20 when the disk keeps up."""


@dataclass(frozen=True, slots=True)
class WriterJob:
    """What is to be written where."""

    file_descriptor: int
    """Of a log that has been begun."""
    written: McapState
    ids: Mapping[str, int]
    """Of the channels, by topic."""
    config: Config | None
    chunk_s: float


@dataclass(slots=True)
class WriterStatus:
    """How far a log was written, and why no further."""

    written_ns: int | None = None
    """Time of the last row that the operating system has; None before the first."""
    error_number: int = 0
    """As of an OSError; 0 where there was none."""
    why: str = ""


class ByteSource(Protocol):
    """Where rows come from."""

    def read1(self, most: int, /) -> bytes:
        """What is there, waiting for the first of it; nothing at the end."""


class RowStream:
    """Rows as they come out of a pipe, in whatever pieces."""

    def __init__(self, inlet: ByteSource) -> None:
        self._inlet = inlet
        self._bytes = b""
        self.is_complete = False
        """Whether the end of the log has come."""

    def take(self) -> tuple[list[tuple[LogRow, JointSample | None]], bool]:
        """All rows that are there, waiting for the first piece, and whether there may be more to come."""
        piece = self._inlet.read1(PIPE_BYTES)
        self._bytes += piece
        rows, at = [], 0
        while not self.is_complete and len(self._bytes) - at >= ROW_HEAD.size:
            time_ns, length, extra = ROW_HEAD.unpack_from(self._bytes, at)
            middle = at + ROW_HEAD.size + length
            if middle + extra > len(self._bytes):
                break
            self.is_complete = length == 0
            if length:
                row = LogRow(time_ns, self._bytes[at + ROW_HEAD.size : middle])
                rows.append(
                    (row, JointSample.from_bytes(self._bytes[middle : middle + extra]) if extra else None)
                )
            at = middle + extra
        self._bytes = self._bytes[at:]
        return rows, bool(piece) and not self.is_complete


def write_rows(
    stream: RowStream, log: McapWriter, expand: Expander, chunk_s: float, ended: WriterStatus
) -> None:
    """Write all that comes, and the summary if the log is complete; OSError if the disk is full or gone."""
    most_rows = MAX_ROWS if chunk_s > 0 else 1
    pause_s = min(chunk_s, CHUNK_S)  # between two looks: the end of the log may come in a long chunk
    waiting: list[tuple[LogRow, JointSample | None]] = []
    due_s, goes_on = 0.0, True
    while goes_on:
        rows, goes_on = stream.take()
        began_s = time.monotonic()
        waiting += rows
        if began_s >= due_s or not goes_on or len(waiting) >= most_rows:
            due_s = began_s + chunk_s - pause_s
            for k in range(0, len(waiting), most_rows):
                log.add_chunk(expand(waiting[k : k + most_rows]))
                ended.written_ns = waiting[min(k + most_rows, len(waiting)) - 1][0].time_ns
            waiting = []
        if goes_on and sum(len(row.data) for row, _ in rows) < PIPE_BYTES // 4:  # there is room to wait
            time.sleep(max(began_s + pause_s - time.monotonic(), 0.0))
    if stream.is_complete:
        log.finish()


def main() -> None:
    """Do the job that comes first on standard input; say on standard output how it ended."""
    sys.stdout.flush()  # what this Python says of itself when it starts
    ended = WriterStatus()
    with FileIO(sys.stdin.fileno(), closefd=False) as raw, BufferedReader(raw) as inlet:
        job: WriterJob = pickle.load(inlet)
        with FileIO(job.file_descriptor, "wb") as file:
            log, expand = McapWriter(file, job.written), Expander(job.config, job.ids)
            _send_status(b"\n" + READY)
            try:
                write_rows(RowStream(inlet), log, expand, job.chunk_s, ended)
            except OSError as error:
                ended.error_number, ended.why = error.errno or errno.EIO, error.strerror or str(error)
    _send_status(json.dumps(asdict(ended)).encode())


def _send_status(text: bytes) -> None:
    with suppress(BrokenPipeError):  # the run has gone
        os.write(sys.stdout.fileno(), text)
