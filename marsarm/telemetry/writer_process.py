"""Process that writes a log: it reads rows from standard input and writes them chunk by chunk.

It runs until its input ends. If the run dies without closing its log, all rows that it sent are written, and
the log is truncated. The run starts this process with interrupts blocked.
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

from marsarm.telemetry.format import CHUNK_S, end_metadata
from marsarm.telemetry.mcap_writer import LogRow, McapState, McapWriter
from marsarm.telemetry.pack import number_messages
from marsarm.telemetry.ros_messages import JointSample, RosEncoder


class Expander:
    """Adds the ROS 2 messages of one arm to its rows; without an encoder it adds none."""

    def __init__(self, encoder: RosEncoder | None, ids: Mapping[str, int]) -> None:
        self._encoder = encoder
        self._ids = ids
        self._counts = dict.fromkeys(ids.values(), 0)
        self._has_begun = False

    def __call__(self, rows: Sequence[tuple[LogRow, JointSample | None]]) -> list[LogRow]:
        """Return the rows; each row with a sample is followed by a row of ROS 2 messages."""
        expanded = []
        for row, sample in rows:
            expanded.append(row)
            if self._encoder is not None and sample is not None:
                expanded.append(self._derived(self._encoder, row.time_ns, sample))
        return expanded

    def _derived(self, encoder: RosEncoder, time_ns: int, sample: JointSample) -> LogRow:
        messages = [] if self._has_begun else list(encoder.static_messages(time_ns))
        self._has_begun = True
        messages += encoder.cycle_messages(time_ns, sample)
        return LogRow(
            time_ns, number_messages(self._counts, time_ns, [(self._ids[t], data) for t, data in messages])
        )


ROW_HEAD: Final = struct.Struct("<QII")
"""Head of a row: log time [ns], length of its records, length of its sample or 0."""
READY: Final = b"ready for rows\n"
"""Line that the process prints when it can read rows."""
PIPE_BYTES: Final = 1 << 20
"""Size of the pipe: seconds of a run in real time."""
MAX_ROWS: Final = 1024
"""Rows in one chunk at most; there are about 20 if the disk is fast enough."""


@dataclass(frozen=True, slots=True)
class WriterJob:
    """Job of the writing process."""

    file_descriptor: int
    """File of a log with header and channels."""
    written: McapState
    ids: Mapping[str, int]
    """Number of each channel, by topic."""
    encoder: RosEncoder | None
    chunk_s: float


@dataclass(slots=True)
class WriterStatus:
    """Status of the writer at its end: the last written row, and the error if there was one."""

    written_ns: int | None = None
    """Log time of the last row that was written; None before the first."""
    error_number: int = 0
    """`errno` of an OSError; 0 without an error."""
    why: str = ""


class ByteSource(Protocol):
    """Source of bytes, such as a pipe."""

    def read1(self, most: int, /) -> bytes:
        """Read the available bytes, after waiting for the first; empty at the end."""


class RowStream:
    """Rows of a pipe, which may deliver them in pieces of any size."""

    def __init__(self, inlet: ByteSource) -> None:
        self._inlet = inlet
        self._bytes = b""
        self.is_complete = False
        """True after the row that ends the log."""
        self.interrupted_by = ""
        """Cause if the run was interrupted; known when the log is complete."""

    def take(self) -> tuple[list[tuple[LogRow, JointSample | None]], bool]:
        """Wait for bytes, then return all complete rows, and whether more may follow."""
        piece = self._inlet.read1(PIPE_BYTES)
        self._bytes += piece
        rows, at = [], 0
        while not self.is_complete and len(self._bytes) - at >= ROW_HEAD.size:
            time_ns, length, extra = ROW_HEAD.unpack_from(self._bytes, at)
            middle = at + ROW_HEAD.size + length
            if middle + extra > len(self._bytes):
                break
            self.is_complete = length == 0
            if self.is_complete:
                self.interrupted_by = self._bytes[middle : middle + extra].decode()
            else:
                row = LogRow(time_ns, self._bytes[at + ROW_HEAD.size : middle])
                rows.append(
                    (row, JointSample.from_bytes(self._bytes[middle : middle + extra]) if extra else None)
                )
            at = middle + extra
        self._bytes = self._bytes[at:]
        return rows, bool(piece) and not self.is_complete


def encode_end(interrupted_by: str) -> bytes:
    """Encode the row that completes a log: it has no records, and the cause if the run was interrupted."""
    cause = interrupted_by.encode()
    return ROW_HEAD.pack(0, 0, len(cause)) + cause


def write_rows(
    stream: RowStream, log: McapWriter, expand: Expander, chunk_s: float, ended: WriterStatus
) -> None:
    """Write all rows of a stream, and the summary if the log is complete.

    Args:
        expand: Function that adds the ROS 2 messages.
        chunk_s: Wall time of a chunk; 0 for one chunk each row.
        ended: Status to update.

    Raises:
        OSError: the disk is full or gone.
    """
    most_rows = MAX_ROWS if chunk_s > 0 else 1
    pause_s = min(chunk_s, CHUNK_S)  # the pipe is read this often, as the log may end during a long chunk
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
        if (
            goes_on and sum(len(row.data) for row, _ in rows) < PIPE_BYTES // 4
        ):  # the pipe has room for the pause
            time.sleep(max(began_s + pause_s - time.monotonic(), 0.0))
    if stream.is_complete:
        log.finish(end_metadata(stream.interrupted_by))


def main() -> None:
    """Do the job that is first on standard input, and print the status on standard output."""
    sys.stdout.flush()  # a message that Python printed at its start
    ended = WriterStatus()
    with FileIO(sys.stdin.fileno(), closefd=False) as raw, BufferedReader(raw) as inlet:
        job: WriterJob = pickle.load(inlet)
        with FileIO(job.file_descriptor, "wb") as file:
            log, expand = McapWriter(file, job.written), Expander(job.encoder, job.ids)
            _send_status(b"\n" + READY)
            try:
                write_rows(RowStream(inlet), log, expand, job.chunk_s, ended)
            except OSError as error:
                ended.error_number, ended.why = error.errno or errno.EIO, error.strerror or str(error)
    _send_status(json.dumps(asdict(ended)).encode())


def _send_status(text: bytes) -> None:
    with suppress(BrokenPipeError):  # the run has ended
        os.write(sys.stdout.fileno(), text)
