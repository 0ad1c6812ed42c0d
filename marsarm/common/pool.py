"""One pool for many independent jobs: on the cores of this machine, or on a Ray cluster.

Jobs go to the workers in tasks of about TASK_S, so that the cost of sending is small. Results come as tasks
complete. A worker that dies costs the jobs of its task, which are repeated. A result depends on its job
alone, so it is the same wherever the job runs.
"""

import math
import os
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, islice
from typing import Any, Final, Protocol, TypeVar

from simgap.common.errors import UserError

Job = TypeVar("Job")
Result = TypeVar("Result")

TASK_S: Final = 0.5
"""Time of work that a task should have. Ray spends up to 5 ms on a task, a hundredth of this."""
MOST_DEATHS: Final = 3
"""Number of workers that may die at a job before the run ends."""


class WorkersDied(UserError):
    """Error for a job at which one worker after the other dies."""

    exit_status = 1


class Runner(Protocol):
    """Function that applies a module-level function to jobs, in parallel."""

    def __call__(self, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """Yield each result when it is ready, in any order."""


@dataclass(frozen=True, slots=True, eq=False)
class TaskOutcome:
    """Results of the jobs of a task, up to the first that raised an error."""

    results: list[Any]
    busy_s: float
    """Time that the jobs took."""
    error: Exception | None = None


class Executor(Protocol):
    """Workers that carry out tasks; a number names a task."""

    @property
    def workers(self) -> int:
        """Return the number of tasks that run at the same time."""

    @property
    def room(self) -> int:
        """Return the number of tasks that may be submitted now."""

    def submit(self, number: int, work: Callable[[Any], Any], jobs: Sequence[Any]) -> None:
        """Send a task to a worker."""

    def wait(self) -> list[tuple[int, TaskOutcome | None]]:
        """Wait until tasks end; return their numbers, and their outcomes or None if the worker died."""

    def stop(self) -> None:
        """Kill all tasks at once."""


def select_runner(workers: int | None, cluster: str | None) -> Runner:
    """Make the runner that a user asks for.

    Args:
        workers: Number of processes on this machine; None for one on each core.
        cluster: Address of a Ray cluster, or "auto"; None for this machine.

    Raises:
        BadRequest: Ray is not installed, or no cluster answers at the address.
    """
    return local_runner(workers or os.cpu_count() or 1) if cluster is None else cluster_runner(cluster)


def local_runner(workers: int) -> Runner:
    """Make a runner with this many processes, reused by the next call; one worker runs in this process."""
    if workers == 1:
        return run_here
    from marsarm.common.local_workers import LocalWorkers

    return _reuse(partial(LocalWorkers, workers))


def run_here(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """Carry out the jobs one after the other in this process: a Runner."""
    return map(work, jobs)


def cluster_runner(address: str = "auto") -> Runner:
    """Make a runner on a Ray cluster, of which this machine is a node.

    Args:
        address: Host and port of its head; or "auto" for RAY_ADDRESS, or else the cluster of this machine.

    Raises:
        BadRequest: Ray is not installed, or no cluster answers at the address.
    """
    from marsarm.common.cluster import connect

    return _reuse(connect(address))


def in_order(run: Runner, work: Callable[..., Result], jobs: Iterable[tuple[Any, ...]]) -> Iterator[Result]:
    """Yield `work(*job)` of each job in the order of the jobs.

    Args:
        run: Runner of parallel jobs.
        work: Function of a module.
        jobs: Arguments of each call.
    """
    early: dict[int, Result] = {}
    following = 0
    for number, result in run(_NumberedCall(work), list(enumerate(jobs))):
        early[number] = result
        while following in early:
            yield early.pop(following)
            following += 1


@dataclass(frozen=True, slots=True)
class _NumberedCall:
    """Function that returns the number of a job with its result."""

    work: Callable[..., Any]

    def __call__(self, job: tuple[int, tuple[Any, ...]]) -> tuple[int, Any]:
        return job[0], self.work(*job[1])


def carry_out(work: Callable[[Any], Any], jobs: Sequence[Any]) -> TaskOutcome:
    """Carry out the jobs of a task, in a worker."""
    began, results = time.perf_counter(), []
    error: Exception | None = None
    for job in jobs:
        try:
            results.append(work(job))
        except Exception as raised:
            raised.add_note(f"in a worker:\n{traceback.format_exc()}")
            error = raised
            break
    return TaskOutcome(results, time.perf_counter() - began, error)


def _reuse(start: Callable[[], Executor]) -> Runner:
    """Make a runner whose executor serves the next call too; a call that ends early stops its executor."""
    idle: list[Executor] = []

    def run(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        if not jobs:
            return
        executor = idle.pop() if idle else start()
        try:
            yield from _schedule(executor, work, jobs)
        except BaseException:  # GeneratorExit and interruptions too
            executor.stop()
            raise
        idle.append(executor)

    return run


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Job that waits or runs."""

    job: Any
    deaths: int = 0
    """Number of workers that died at it."""


def _schedule(executor: Executor, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """Keep the workers busy, and yield results; the workers go on while the caller has one."""
    queue, numbers = _Queue(jobs), count()
    running: dict[int, list[_Attempt]] = {}
    ready: list[Result] = []
    error: Exception | None = None
    while True:
        while error is None and executor.room > 0 and (task := queue.take(executor.workers)):
            number = next(numbers)
            executor.submit(number, work, [attempt.job for attempt in task])
            running[number] = task
        yield from ready
        if error is not None:
            raise error
        if not running:
            return
        ready, lost = [], 0
        for number, outcome in executor.wait():
            task = running.pop(number)
            if outcome is None:
                lost += 1
                queue.put_back(task)
                continue
            queue.update_time(outcome)
            ready += outcome.results
            error = error or outcome.error
        if lost:
            workers = "a worker died; its" if lost == 1 else f"{lost} workers died; their"
            print(f"{workers} work items are repeated", file=sys.stderr, flush=True)


class _Queue:
    """Jobs that wait, and the number of them that make a task."""

    def __init__(self, jobs: Sequence[Any]) -> None:
        self._fresh = iter(jobs)
        self._left = len(jobs)
        self._again: deque[_Attempt] = deque()
        self._job_s: float | None = None
        self._most = 1

    def take(self, workers: int) -> list[_Attempt]:
        """Take the jobs of the next task; none if no job waits. A job whose worker died is alone."""
        if self._again:
            return [self._again.popleft()]
        size = 1
        if self._job_s is not None:
            wanted = TASK_S / max(self._job_s, 1e-9)
            share = math.ceil(self._left / (2 * workers))  # else the last tasks would be late
            size = max(1, int(min(wanted, share, self._most)))
            self._most = max(self._most, 2 * size)
        task = [_Attempt(job) for job in islice(self._fresh, size)]
        self._left -= len(task)
        return task

    def update_time(self, outcome: TaskOutcome) -> None:
        """Estimate the time of a job; the first one of a worker takes longer, so old values lose weight."""
        if outcome.results:
            job_s = outcome.busy_s / len(outcome.results)
            self._job_s = job_s if self._job_s is None else (self._job_s + job_s) / 2

    def put_back(self, task: Sequence[_Attempt]) -> None:
        """Put back the jobs of a worker that died.

        Raises:
            WorkersDied: Too many workers have died at a job.
        """
        for attempt in task:
            if attempt.deaths + 1 >= MOST_DEATHS:
                raise WorkersDied(
                    f"workers: {MOST_DEATHS} of them died one after the other at the same work item, as "
                    "when the memory is full; use fewer workers, or machines with more memory"
                )
            self._again.append(replace(attempt, deaths=attempt.deaths + 1))
