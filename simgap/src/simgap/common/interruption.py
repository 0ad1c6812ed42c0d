"""Signals that end a command: one exception for all of them, and sections that they do not break apart."""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Final, TextIO

END_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a command to end: Ctrl-C, kill, and a terminal that is closed."""
GRACE_S: Final = 1.5
"""Time after which an interrupted command ends without its clean-up, because something does not return.

A command has to end within 2 s of a signal; 0.5 s remain to kill its workers and to end the process.
"""
_REPORTED: Final = threading.Event()
"""Set when the sentence about an interruption is printed, because a command prints one."""


class Interrupted(BaseException):
    """A signal asks the command to end; no Exception, so that nobody mistakes it for an error.

    Notes of the exception say what the command leaves behind.
    """

    def __init__(self, number: int) -> None:
        self.signal = signal.Signals(number)
        super().__init__(self.signal.name)

    @property
    def exit_status(self) -> int:
        """Exit status of the command, as a shell reports it for this signal."""
        return 128 + self.signal

    @property
    def sentence(self) -> str:
        """Sentence for the user."""
        notes = getattr(self, "__notes__", ())
        return "; ".join((f"interrupted by {self.signal.name} before the end", *notes))


def describe_interruption(error: BaseException) -> str:
    """Return a short text for the cause of an interruption: the signal, or the class of the exception."""
    return error.signal.name if isinstance(error, Interrupted) else type(error).__name__


class _Deferral:
    """Section of the main thread in which no signal raises an exception; a context manager."""

    def __init__(self) -> None:
        self.depth = 0
        self.pending: int | None = None

    def __enter__(self) -> None:
        self.depth += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.depth -= 1
        if self.depth == 0 and self.pending is not None:
            number, self.pending = self.pending, None
            raise Interrupted(number)


defer_interrupts: Final = _Deferral()
"""Context manager: a signal that arrives in its block raises `Interrupted` at the end of the block.

A mask of signals is not enough, because another thread of the process may receive the signal.
"""


@contextmanager
def report_interruption() -> Iterator[None]:
    """Let signals interrupt a block; print one sentence about it, and exit with its status."""
    raise_on_signals()
    try:
        yield
    except BaseException as error:
        interrupted = _find_interruption(error)
        if interrupted is None:
            raise
        from traceback import clear_frames  # loaded late: this module is the first that a command loads

        # A generator whose block the signal prevented stays suspended, and its file is there, as long as a
        # frame of the traceback holds it.
        clear_frames(interrupted.__traceback__)
        _report(interrupted.sentence, sys.stdout)
        sys.exit(interrupted.exit_status)


def _find_interruption(error: BaseException | None) -> Interrupted | None:
    """Return the interruption that caused an error.

    An extension module that is interrupted while it is imported raises ImportError from the interruption.
    """
    while error is not None and not isinstance(error, Interrupted):
        error = error.__cause__ or error.__context__
    return error


def _report(sentence: str, stdout: TextIO | None) -> None:
    """Print the sentence, and its document if JSON is wanted, unless one was printed already."""
    if _REPORTED.is_set():
        return
    _REPORTED.set()
    if "--json" in sys.argv:
        print(json.dumps({"error": sentence}), file=stdout, flush=True)
    print(sentence, file=sys.stderr, flush=True)


def raise_on_signals() -> None:
    """Let the first of END_SIGNALS raise `Interrupted` in the main thread, and ignore all later ones.

    A signal that is ignored already stays ignored, as `nohup` asks for.
    """
    _REPORTED.clear()
    for number in END_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(number: int, _: FrameType | None) -> None:
    for other in END_SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    threading.Thread(target=_end_late, args=(number,), daemon=True).start()
    if defer_interrupts.depth:
        defer_interrupts.pending = number
        return
    raise Interrupted(number)


def _end_late(number: int) -> None:
    """End the process if it still runs after the grace: the exception was swallowed, or a disk hangs."""
    time.sleep(GRACE_S)
    ended = Interrupted(number)
    with suppress(OSError, ValueError):  # what is in sys.stdout may be half a result, and is left out
        _report(f"{ended.sentence}; it did not end by itself", sys.__stdout__)
    from multiprocessing import active_children  # loaded late: this module is the first that a command loads

    for child in active_children():
        child.kill()
    os._exit(ended.exit_status)


@contextmanager
def block_signals() -> Iterator[None]:
    """Block END_SIGNALS in this thread; processes that start in the block inherit this.

    Ctrl-C goes to all processes of a terminal, and only the command itself must answer it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
