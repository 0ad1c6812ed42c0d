"""What becomes of the output of a command when nobody takes it."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, TextIOWrapper
from typing import Final

from ground.cli.options import BAD_INPUT

UNREAD: Final = 128 + signal.SIGPIPE
"""The status of a program whose reader has gone, as `head` does."""


@contextmanager
def checked_stdout() -> Iterator[None]:
    """Keep what is printed and write it at the end: a full disk ends with a sentence, a gone reader quietly.

    A terminal gets it at once.
    """
    real = sys.stdout
    if real is None or real.isatty():
        yield
        return
    kept = BytesIO()
    sys.stdout = TextIOWrapper(kept, real.encoding, real.errors, write_through=True)
    try:
        yield
    finally:
        printed = kept.getvalue()
        sys.stdout = real
        _write(printed)


def _write(printed: bytes) -> None:
    try:
        sys.stdout.buffer.write(printed)
        sys.stdout.flush()
    except BrokenPipeError:
        _give_up()
        sys.exit(UNREAD)
    except OSError as error:
        _give_up()
        print(f"standard output: cannot be written ({error.strerror}); give it room", file=sys.stderr)
        sys.exit(BAD_INPUT)


def _give_up() -> None:
    """Let the interpreter not try again when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
