"""Hands the rows of a run to the process that writes its log, so that no control cycle waits for the disk.

The pipe between them is the queue. Only when it is full, because the disk did not keep up for as long as it
holds, does a cycle wait for it too.
"""

import errno
import fcntl
import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from typing import Final

from fsw.config import Config
from ground.telemetry.mcap_writer import McapState
from ground.telemetry.ros_messages import JointSample
from ground.telemetry.writer_process import END, PIPE_BYTES, READY, ROW_HEAD, WriterJob, WriterStatus

WRITER_CODE: Final = "import sys; sys.path[:] = {}; from ground.telemetry.writer_process import main; main()"
CODE_PATH: Final = [os.path.abspath(folder) for folder in sys.path]
"""Where this process found the code, whatever folder it works in later."""
RUN_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What is sent to a whole group of processes and is for the run, which ends its log."""


class WriterPipe:
    """A log in the hands of its writer; nothing that was put is dropped silently."""

    def __init__(
        self, file: FileIO, written: McapState, ids: Mapping[str, int], config: Config | None, chunk_s: float
    ) -> None:
        """Share the file of a log that has been begun; OSError if there can be no process to write it."""
        job = pickle.dumps(WriterJob(file.fileno(), written, ids, config, chunk_s))
        self._process = os.getpid()
        self._ended: WriterStatus | None = None
        self._is_torn = False
        with ExitStack() as on_failure:
            with _block_signals(RUN_SIGNALS):
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
        """Of the writer."""
        return self._writer.pid

    @property
    def written_ns(self) -> int | None:
        """Time of the last row that the operating system has, known once the writer has ended."""
        return None if self._ended is None else self._ended.written_ns

    def put(self, time_ns: int, data: bytes, sample: JointSample | None) -> None:
        """Hand over the records of a cycle, and what the messages for other tools are made of.

        Raises:
            OSError: what ended the writer.
            ValueError: the log is closed, or what was put before was interrupted on its way.
        """
        if os.getpid() != self._process:
            raise RuntimeError("a log is written by the process that opened it; open another here")
        if self._ended is not None:
            self._raise()
            raise ValueError("the log is closed; open another to record more")
        if self._is_torn:
            raise ValueError("a cycle was interrupted on its way into the log, and none can follow; close it")
        self._send(encode_row(time_ns, data, sample))

    def close(self) -> None:
        """Have the log completed, and wait for it; OSError if it could not be."""
        if os.getpid() != self._process:  # a fork, for which it is not to be completed or waited for
            self._inlet.close()
            self._outlet.close()
            self._writer.returncode = 0
            return
        if self._ended is None and not self._is_torn:
            with suppress(OSError):  # the writer has ended, and says why
                self._send(END)
        self._end()
        self._raise()

    def _widen(self) -> None:
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            with suppress(OSError):  # beyond what this user may have, it holds what it holds
                fcntl.fcntl(self._inlet, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    def _send(self, data: bytes) -> None:
        self._is_torn = True  # until all is sent: what comes after half a row would not be understood
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._inlet.write(rest) :]
        except BrokenPipeError:
            self._end()
            self._raise()
            raise
        self._is_torn = False

    def _end(self) -> None:
        """Let the writer end, and hear how it did."""
        if self._ended is not None:
            return
        self._inlet.close()
        with self._outlet:
            said = self._outlet.read().rpartition(b"\n")[2]  # behind what was not waited for
        status = self._writer.wait()
        self._ended = (
            WriterStatus(**json.loads(said))
            if said
            else WriterStatus(None, errno.EPIPE, _describe_exit(status))
        )

    def _raise(self) -> None:
        if self._ended is not None and self._ended.error_number:
            raise OSError(self._ended.error_number, self._ended.why)


@contextmanager
def _block_signals(signals: tuple[signal.Signals, ...]) -> Iterator[None]:
    """Processes that are started in the block never get these signals."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def encode_row(time_ns: int, data: bytes, sample: JointSample | None) -> bytes:
    """A row as the writer takes it."""
    extra = b"" if sample is None else sample.to_bytes()
    return b"".join((ROW_HEAD.pack(time_ns, len(data), len(extra)), data, extra))


def _describe_exit(status: int) -> str:
    how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
    return f"the process that wrote it {how}"
