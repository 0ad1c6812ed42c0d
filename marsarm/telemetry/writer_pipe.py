"""Pipe to the process that writes a log, so that no control cycle waits for the disk.

The pipe is the queue. A cycle waits only if the pipe is full, because the disk was too slow for seconds.
"""

import errno
import fcntl
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from io import FileIO
from typing import Final

from marsarm.telemetry.mcap_writer import McapState
from marsarm.telemetry.ros_messages import JointSample, RosEncoder
from marsarm.telemetry.writer_process import (
    PIPE_BYTES,
    READY,
    ROW_HEAD,
    WriterJob,
    WriterStatus,
    encode_end,
)
from simgap.common.interruption import block_signals, defer_interrupts

WRITER_CODE: Final = "import sys; sys.path[:] = {}; from marsarm.telemetry.writer_process import main; main()"
CODE_PATH: Final = [os.path.abspath(folder) for folder in sys.path]
"""Absolute import path of this process, which may change its working folder later."""


class WriterPipe:
    """Connection to the process that writes a log; no row is lost without an error."""

    def __init__(
        self,
        file: FileIO,
        written: McapState,
        ids: Mapping[str, int],
        encoder: RosEncoder | None,
        chunk_s: float,
    ) -> None:
        """Start the process that continues the log in `file`.

        Raises:
            OSError: the process cannot start.
        """
        job = pickle.dumps(WriterJob(file.fileno(), written, ids, encoder, chunk_s))
        self._process = os.getpid()
        self._ended: WriterStatus | None = None
        self._is_torn = False
        with ExitStack() as on_failure:
            with block_signals():  # the run handles them; it then closes its log
                self._writer = subprocess.Popen(
                    [sys.executable, "-c", WRITER_CODE.format(CODE_PATH)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    bufsize=0,
                    pass_fds=(file.fileno(),),
                )
                assert self._writer.stdin is not None
                assert self._writer.stdout is not None
                self._inlet, self._outlet = self._writer.stdin, self._writer.stdout
                on_failure.callback(self._end)
                self._widen()
                self._send(job)
            if READY in iter(self._outlet.readline, b""):
                on_failure.pop_all()
        self._raise()

    @property
    def process(self) -> int:
        """Id of the writing process."""
        return self._writer.pid

    @property
    def written_ns(self) -> int | None:
        """Time of the last written row; None before the writer has ended, or without a row."""
        return None if self._ended is None else self._ended.written_ns

    def put(self, time_ns: int, data: bytes, sample: JointSample | None) -> None:
        """Send the records of a cycle, and its sample for the messages to other tools.

        Raises:
            OSError: the writer has ended; the error is its own.
            ValueError: the log is closed, or an earlier call was interrupted.
            RuntimeError: another process opened the log.
        """
        if os.getpid() != self._process:
            raise RuntimeError("a log is written by the process that opened it; open another here")
        if self._ended is not None:
            self._raise()
            raise ValueError("the log is closed; open another to record more")
        if self._is_torn:
            raise ValueError("a cycle was interrupted on its way into the log, and none can follow; close it")
        self._send(encode_row(time_ns, data, sample))

    def close(self, interrupted_by: str = "") -> None:
        """Complete the log and wait for the writer.

        Args:
            interrupted_by: Cause if the run was interrupted; empty if it was not.

        Raises:
            OSError: the log could not be completed.
        """
        if os.getpid() != self._process:  # a fork must neither complete the log nor wait for the writer
            self._inlet.close()
            self._outlet.close()
            self._writer.returncode = 0
            return
        if self._ended is None and not self._is_torn:
            with suppress(OSError):  # the writer has ended; _raise reports why
                self._send(encode_end(interrupted_by))
        self._end()
        self._raise()

    def _widen(self) -> None:
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            with suppress(OSError):  # the user may not have a pipe of this size
                fcntl.fcntl(self._inlet, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    def _send(self, data: bytes) -> None:
        self._is_torn = True  # until all is sent: the writer could not read a row after half a row
        rest = memoryview(data)
        try:
            with defer_interrupts:
                while rest:
                    rest = rest[self._inlet.write(rest) :]
                self._is_torn = False
        except BrokenPipeError:
            self._end()
            self._raise()
            raise

    def _end(self) -> None:
        """Close the pipe, wait for the writer and read its status."""
        if self._ended is not None:
            return
        self._inlet.close()
        with self._outlet:
            report = self._outlet.read().rpartition(b"\n")[2]  # the last line
        exit_status = self._writer.wait()
        self._ended = (
            WriterStatus(**json.loads(report))
            if report
            else WriterStatus(None, errno.EPIPE, _describe_exit(exit_status))
        )

    def _raise(self) -> None:
        if self._ended is not None and self._ended.error_number:
            raise OSError(self._ended.error_number, self._ended.why)


def encode_row(time_ns: int, data: bytes, sample: JointSample | None) -> bytes:
    """Encode a row for the writer."""
    extra = b"" if sample is None else sample.to_bytes()
    return b"".join((ROW_HEAD.pack(time_ns, len(data), len(extra)), data, extra))


def _describe_exit(status: int) -> str:
    how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
    return f"the process that wrote it {how}"
