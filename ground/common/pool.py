"""Runners that apply a function to many jobs: on the cores of this machine, or on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Protocol, TypeVar

from ground.common.errors import BadRequest
from ground.common.interruption import Interrupted, block_signals

Job = TypeVar("Job")
Result = TypeVar("Result")


class Runner(Protocol):
    """Function that applies a module-level function to jobs, in parallel."""

    def __call__(self, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """Yield each result when it is ready, in any order."""


def local_runner(workers: int) -> Runner:
    """Make a runner with this many processes, reused by the next call; one worker runs in this process."""
    idle: list[ProcessPoolExecutor] = []

    def run(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        if workers == 1:
            yield from map(work, jobs)
            return
        pool = idle.pop() if idle else ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
        try:
            with block_signals():  # only this process answers Ctrl-C
                waiting = [pool.submit(work, job) for job in jobs]
            for done in as_completed(waiting):
                yield done.result()
        except BaseException as error:  # GeneratorExit too: the caller may stop early
            workers_left = tuple(pool._processes.values()) if isinstance(error, Interrupted) else ()
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers_left:  # else Python would wait at its end for the jobs that they are at
                worker.kill()
            raise
        idle.append(pool)

    return run


def cluster_runner() -> Runner:
    """Make a runner on the Ray cluster that RAY_ADDRESS names, or on a new local one.

    The nodes of the cluster must have marsarm installed.

    Raises:
        BadRequest: ray is not installed.
    """
    try:
        import ray
    except ImportError as error:
        raise BadRequest(
            "cluster: ray is not installed; pip install 'marsarm[cluster]', or leave out --cluster and use "
            "the cores of this machine"
        ) from error

    def run(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        ray.init(ignore_reinit_error=True, log_to_driver=False)
        remote = ray.remote(work)
        waiting = [remote.remote(job) for job in jobs]
        while waiting:
            done, waiting = ray.wait(waiting)
            yield from ray.get(done)

    return run
