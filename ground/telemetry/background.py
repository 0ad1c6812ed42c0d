"""The thread that writes a log, so that no control cycle waits for compression or the disk."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final
from weakref import WeakSet

from ground.telemetry.mcap_file import McapFile, Row

MOST_ROWS: Final = 1024
"""In one chunk, of what waits; a chunk has about 20 when the disk keeps up."""
MOST_WAITING: Final = 65_536
"""Rows that may wait for a disk that does not keep up, about 100 MB; then the cycles wait for it too."""
SHORTEST_S: Final = 0.001
LATE: Final = 1.6
"""In periods: when the thread has not written for so long, a cycle does."""

Expand = Callable[[Sequence[Row]], Sequence[Row]]


class Background:
    """Takes rows and writes them, every so often, as a chunk; nothing that is taken is dropped silently.

    `expand` adds to rows what is made of them; it runs in the thread.
    """

    def __init__(self, file: McapFile, expand: Expand, chunk_s: float) -> None:
        self._file = file
        self._expand = expand
        self._period_s = max(chunk_s, SHORTEST_S)
        self._most_rows = MOST_ROWS if chunk_s > 0 else 1
        self._rows: deque[Row] = deque()
        self._writing = threading.Lock()
        self._late_s = time.monotonic() + LATE * self._period_s
        self._open = threading.Lock()
        """Held until the log is to be closed: to wait for it costs a fifth of waiting for an Event."""
        self._open.acquire()
        self._thread = threading.Thread(target=self._run, name="marsarm log", daemon=True)
        self.failure: BaseException | None = None
        """What ended the writing; every later `put` and `close` raises it."""
        self.written_ns: int | None = None
        """Time of the last row that the operating system has; None before the first."""
        self._is_closed = False
        _open.add(self)
        self._thread.start()

    def put(self, row: Row) -> None:
        """Take a row; raises what ended the writing, or ValueError once the log is closed."""
        while len(self._rows) > MOST_WAITING and self.failure is None:
            time.sleep(SHORTEST_S)
        if self.failure is not None:
            raise self.failure
        if self._is_closed:
            raise ValueError("the log is closed; open another to record more")
        self._rows.append(row)
        if time.monotonic() > self._late_s and self._writing.acquire(blocking=False):
            # The machine has not let the thread run: some 200 us now, so that a kill costs no more.
            try:
                self._write_waiting()
            finally:
                self._writing.release()

    def close(self) -> None:
        """Write what waits and end the file; raises what ended the writing."""
        if self not in _open:
            return  # in a process that was forked while the log was open: it is the other's to close
        _open.discard(self)
        self._is_closed = True
        self._open.release()
        if self._thread is not threading.current_thread():  # where garbage is collected is not ours to say
            self._thread.join()
        if self.failure is not None:
            raise self.failure

    def _run(self) -> None:
        try:
            due_s = time.monotonic() + self._period_s
            while not self._open.acquire(timeout=max(due_s - time.monotonic(), SHORTEST_S)):
                due_s = time.monotonic() + self._period_s  # of the next one, whatever this one takes
                with self._writing:
                    self._write_waiting()
            with self._writing:
                self._write_waiting()
                self._file.finish()
        except BaseException as error:
            self.failure = error
        finally:
            self._file.close()

    def _write_waiting(self) -> None:
        """Write what waits; whoever calls it holds the lock."""
        if self.failure is not None:
            raise self.failure
        self._late_s = time.monotonic() + LATE * self._period_s
        try:
            while self._rows:
                rows = [self._rows.popleft() for _ in range(min(len(self._rows), self._most_rows))]
                self._file.add_chunk(self._expand(rows))
                self.written_ns = rows[-1].time_ns
        except BaseException as error:
            self.failure = error
            raise

    def forget(self) -> None:
        """Have nothing more to do with the log: in a forked process there is no thread to write it."""
        self.failure = RuntimeError("a log is written by the process that opened it; open another here")
        self._rows.clear()
        self._file.close()


_open: WeakSet[Background] = WeakSet()


def _after_fork() -> None:
    for one in list(_open):
        _open.discard(one)
        one.forget()


os.register_at_fork(after_in_child=_after_fork)
