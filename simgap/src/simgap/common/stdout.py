"""Standard output of a command: buffered, so that a full disk gives one error and a closed pipe none."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, TextIOWrapper
from typing import Final, TextIO

EXIT_BAD_INPUT: Final = 2
EXIT_PIPE_CLOSED: Final = 128 + signal.SIGPIPE
"""Exit status of a program whose reader has closed the pipe, as `head` does."""


class BufferedStdout(TextIOWrapper):
    """Text that is kept until it is released to the standard output."""

    def __init__(self, stdout: TextIO) -> None:
        self._kept = BytesIO()
        super().__init__(self._kept, stdout.encoding, stdout.errors, write_through=True)
        self._stdout = stdout

    def release(self) -> None:
        """Write what was kept; end the command if that is impossible."""
        printed = self._kept.getvalue()
        self._kept.seek(0)
        self._kept.truncate()
        _write(self._stdout, printed)


@contextmanager
def buffer_stdout() -> Iterator[None]:
    """Buffer the standard output and write it when the block ends, unless it is a terminal."""
    stdout = sys.stdout
    if stdout is None or stdout.isatty():
        yield
        return
    buffered = BufferedStdout(stdout)
    sys.stdout = buffered
    try:
        yield
    finally:
        sys.stdout = stdout
        buffered.release()


def release_stdout() -> None:
    """Write what was printed so far, for a program that reads it while the command continues."""
    if isinstance(sys.stdout, BufferedStdout):
        sys.stdout.release()


def _write(stdout: TextIO, printed: bytes) -> None:
    try:
        stdout.buffer.write(printed)
        stdout.flush()
    except BrokenPipeError:
        _discard(stdout)
        sys.exit(EXIT_PIPE_CLOSED)
    except OSError as error:
        _discard(stdout)
        print(f"standard output: cannot be written ({error.strerror}); give it room", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)


def _discard(stdout: TextIO) -> None:
    """Redirect the standard output to the null device: the interpreter flushes it once more on exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())
