"""Many pieces of work at once: on the cores of this machine, or on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Protocol, TypeVar

from ground.common.requests import BadRequest

Job = TypeVar("Job")
Result = TypeVar("Result")


class Runner(Protocol):
    """Does work, a function of a module, on jobs; results come as they are done, in any order."""

    def __call__(self, work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """The results."""


def local_runner(workers: int) -> Runner:
    """In so many processes, that stay for the next call; with one, in this process."""
    idle: list[ProcessPoolExecutor] = []

    def run(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        if workers == 1:
            yield from map(work, jobs)
            return
        pool = idle.pop() if idle else ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
        try:
            for done in as_completed([pool.submit(work, job) for job in jobs]):
                yield done.result()
        except BaseException:  # also of who asks no more
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        idle.append(pool)

    return run


def cluster_runner() -> Runner:
    """On the Ray cluster that RAY_ADDRESS names, or on one that is started here; marsarm is installed on it.

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
