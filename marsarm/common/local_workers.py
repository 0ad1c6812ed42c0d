"""Worker processes of this machine."""

import weakref
from collections.abc import Callable, Sequence
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from marsarm.common.pool import TaskOutcome, carry_out
from simgap.common.interruption import block_signals


class LocalWorkers:
    """Executor with a number of processes, which start when they are needed.

    Each process has a pipe of its own, so that the death of one is noticed at once and costs its task only.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._idle: list[Connection] = []
        self._running: dict[Connection, int] = {}
        self._process: dict[Connection, BaseProcess] = {}
        weakref.finalize(self, _kill, self._process)

    @property
    def room(self) -> int:
        """Return the number of idle workers; a task that waits is not bound to one yet."""
        return self.workers - len(self._running)

    def submit(self, number: int, work: Callable[[Any], Any], jobs: Sequence[Any]) -> None:
        """Send a task to an idle worker, or to a new one."""
        while True:
            pipe = self._idle.pop() if self._idle else self._start()
            try:
                pipe.send((work, jobs))
            except BrokenPipeError:  # it died while it was idle
                self._remove(pipe)
                continue
            self._running[pipe] = number
            return

    def wait(self) -> list[tuple[int, TaskOutcome | None]]:
        """Wait until tasks end; None for the outcome of one whose process died."""
        ended: list[tuple[int, TaskOutcome | None]] = []
        for pipe in wait(list(self._running)):
            assert isinstance(pipe, Connection)
            number = self._running.pop(pipe)
            try:
                ended.append((number, pipe.recv()))
                self._idle.append(pipe)
            except (EOFError, ConnectionError):
                self._remove(pipe)
                ended.append((number, None))
        return ended

    def stop(self) -> None:
        """Kill all processes."""
        _kill(self._process)
        self._idle.clear()
        self._running.clear()

    def _start(self) -> Connection:
        context = get_context("spawn")
        pipe, end = context.Pipe()
        process = context.Process(target=_serve, args=(end,), daemon=True)
        resource_tracker.ensure_running()  # which unblocks signals when it starts
        with block_signals():  # the command answers Ctrl-C, also while a worker starts
            process.start()
        end.close()
        self._process[pipe] = process
        return pipe

    def _remove(self, pipe: Connection) -> None:
        pipe.close()
        process = self._process.pop(pipe)
        process.kill()
        process.join()


def _kill(processes: dict[Connection, BaseProcess]) -> None:
    """Kill the processes of the pipes; those that are idle lose nothing."""
    for process in processes.values():
        process.kill()
    while processes:
        pipe, process = processes.popitem()
        process.join()
        pipe.close()


def _serve(pipe: Connection) -> None:
    """Carry out tasks until the pipe is closed, with END_SIGNALS blocked."""
    while True:
        try:
            work, jobs = pipe.recv()
        except EOFError:
            return
        except Exception as error:  # the function or a job cannot be loaded here
            pipe.send(TaskOutcome([], 0.0, error))
            continue
        outcome = carry_out(work, jobs)
        try:
            pipe.send(outcome)
        except BrokenPipeError:
            return
        except Exception as error:  # a result cannot be sent
            pipe.send(TaskOutcome([], outcome.busy_s, error))
