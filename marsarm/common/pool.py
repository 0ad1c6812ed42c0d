"""Many independent jobs in parallel: in processes of this machine by joblib, or on a Ray cluster.

A result depends on its job alone, so it is the same wherever the job runs. A worker that dies costs the jobs
that were under way, which are repeated.
"""

import os
import sys
import traceback
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Protocol, TypeVar

from simgap.common.errors import UserError
from simgap.common.interruption import block_signals, defer_interrupts

Job = TypeVar("Job")
Result = TypeVar("Result")

MOST_DEATHS: Final = 3
"""Number of times that workers may die before the run ends: on a cluster at a job, here in all."""
IDLE_S: Final = 30.0
"""Time after which a worker without a job ends, also if the command was killed."""


class WorkersDied(UserError):
    """Error for a job at which one worker after the other dies."""

    exit_status = 1

    def __init__(self) -> None:
        super().__init__(
            f"workers: {MOST_DEATHS} of them died one after the other at the same work items, as when the "
            "memory is full; use fewer workers, or machines with more memory"
        )


class Runner(Protocol):
    """Function that applies a module-level function to jobs, in parallel."""

    def __call__(self, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """Yield each result when it is ready, in any order."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Result of a job, or its error."""

    result: Any
    error: Exception | None = None

    def unwrap(self) -> Any:
        """Return the result, or raise the error of the job."""
        if self.error is not None:
            raise self.error
        return self.result


def select_runner(workers: int | None, cluster: str | None) -> Runner:
    """Make the runner that a user asks for.

    Args:
        workers: Number of processes on this machine; None for one on each core.
        cluster: Host and port of the head of a Ray cluster, of which this machine is a node; "auto" for
            RAY_ADDRESS, or else the cluster of this machine; None for this machine alone.

    Raises:
        BadRequest: Ray is not installed, or no cluster answers at the address.
    """
    if cluster is None:
        return local_runner(workers or os.cpu_count() or 1)
    from marsarm.common.cluster import connect  # loaded late: most commands use no cluster

    return connect(cluster)


def local_runner(workers: int) -> Runner:
    """Make a runner with this many processes, which serve the next call too; one works in this process."""
    return run_here if workers == 1 else partial(_run_in_processes, workers)


def run_here(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """Carry out the jobs one after the other in this process: a Runner."""
    return map(work, jobs)


def in_order(run: Runner, work: Callable[..., Result], jobs: Iterable[tuple[Any, ...]]) -> Iterator[Result]:
    """Yield `work(*job)` of each job in the order of the jobs; `work` is a function of a module."""
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


def attempt(work: Callable[[Any], Any], job: Any) -> Outcome:
    """Carry out a job in a worker."""
    try:
        return Outcome(work(job))
    except Exception as error:
        error.add_note(f"in a worker:\n{traceback.format_exc()}")
        return Outcome(None, error)


def _run_in_processes(workers: int, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """Yield results as they come; jobs that were under way when a worker died are repeated."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError  # joblib takes 0.2 s to load

    left = dict(enumerate(jobs))
    for deaths in range(1, MOST_DEATHS + 1):
        try:
            with closing(_start_processes(workers, work, list(left.items()))) as outcomes:
                for number, outcome in outcomes:
                    del left[number]
                    yield outcome.unwrap()
            return
        except TerminatedWorkerError:
            if deaths < MOST_DEATHS:
                print("a worker died; its work items are repeated", file=sys.stderr, flush=True)
    raise WorkersDied


def _start_processes(
    workers: int, work: Callable[[Any], Any], jobs: Sequence[tuple[int, Any]]
) -> Generator[tuple[int, Outcome], None, None]:
    from multiprocessing import resource_tracker

    from joblib import Parallel, cpu_count, delayed, parallel_config

    numbered = _NumberedCall(partial(attempt, work))
    options = {
        # Linear algebra has as many threads as here, so that it rounds alike.
        "inner_max_num_threads": int(os.environ.get("OPENBLAS_NUM_THREADS") or cpu_count()),
        "idle_worker_timeout": IDLE_S,
    }
    resource_tracker.ensure_running()  # which unblocks signals when it starts
    # Ctrl-C goes to all processes of a terminal, and only the command itself must answer it.
    with block_signals(), defer_interrupts, parallel_config("loky", **options):
        parallel = Parallel(workers, return_as="generator_unordered", max_nbytes=None)
        found = parallel(delayed(numbered)((number, (job,))) for number, job in jobs)
    try:
        for one in found:  # noqa: UP028
            yield one  # `yield from` would close it before the warning is silenced
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that a run ended early, which the caller knows
            found.close()
