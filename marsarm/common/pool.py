"""Many independent jobs in parallel: in processes of this machine by joblib, or on a Ray cluster.

A result depends on its job alone, so it is the same wherever the job runs. A worker that dies costs the jobs
that were under way, which are repeated.

Each node of a cluster must have the software of this machine, and compute the same bits; each worker is asked
with its first task. Ray is optional. Its backend of joblib is not used: it returns no result before the last
job has ended, so that an interrupted run would leave nothing.
"""

import atexit
import hashlib
import logging
import math
import os
import platform
import signal
import socket
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np

from simgap.common.errors import BadRequest, RobotError, UserError
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
    """Make the runner that a user asks for, with so many processes of this machine, or one on each core.

    Args:
        cluster: Host and port of the head of a Ray cluster, of which this machine is a node; "auto" for
            RAY_ADDRESS, or else the cluster of this machine; None for this machine alone.

    Raises:
        BadRequest: Ray is not installed, or no cluster answers at the address.
    """
    if cluster is None:
        return local_runner(workers or os.cpu_count() or 1)
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


PACKAGES: Final = ("numpy", "scipy", "mujoco-core", "ruckig", "ray")
"""Packages whose version changes results, or how they are sent."""
SOURCES: Final = ("fsw", "sim", "simgap", "marsarm")
SUFFIXES: Final = (".py", ".toml", ".xml")
TASK_S: Final = 0.5
"""Time of work that a task should have. Ray spends up to 5 ms on a task, a hundredth of this."""
CONNECT_S: Final = 5.0
"""Time in which the head of a cluster has to answer."""
QUEUED: Final = 2
"""Tasks for each processor: one that runs, and one that waits at its node while results travel."""

Description = dict[str, str]


class ClusterFailed(UserError):
    """Error of Ray that a repetition of the task would not mend."""

    exit_status = 1


@dataclass(frozen=True, slots=True, eq=False)
class TaskOutcome:
    """Outcomes of the jobs of a task, and the time that they took."""

    host: str
    outcomes: list[Outcome]
    busy_s: float
    difference: str = ""
    """How the node differs from the machine that asks; then no job was carried out."""


def connect(address: str) -> Runner:
    """Return a runner on a cluster; BadRequest without Ray, or if none answers at the address."""
    try:
        import ray
    except ImportError as error:
        raise BadRequest(
            "cluster: ray is not installed; pip install 'marsarm[cluster]', or leave out --cluster and use "
            "the cores of this machine"
        ) from error
    if not ray.is_initialized():
        before = signal.getsignal(signal.SIGTERM)
        try:
            _check_answers(os.environ.get("RAY_ADDRESS", address) if address == "auto" else address)
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            atexit.register(ray.shutdown)  # that of ray itself first sleeps for half a second
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise BadRequest(
                f"cluster {address}: cannot be used ({_first_line(error)}); give HOST:PORT of a head that "
                "`ray start --head` started, on one of its nodes"
            ) from error
        finally:
            signal.signal(signal.SIGTERM, before)  # ray replaces it
    return partial(_run, ray)


def _check_answers(head: str) -> None:
    """Raise a ConnectionError if nothing listens there; ray would try for minutes."""
    if head == "auto":
        return
    host, _, port = head.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise ConnectionError(f"nothing answers at {head}") from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0].rstrip(".")


def _run(ray: Any, work: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Any]:
    """Keep the processors busy, and yield results as they come."""
    task = ray.remote(num_cpus=1, max_retries=0)(carry_out_there)
    expected = describe_computer(_list_packages(work))
    fresh, left, size = iter(jobs), len(jobs), 1
    again: list[tuple[Any, int]] = []
    # Ray's own wait is not used: it holds back signals.
    running: dict[Future[Any], tuple[Any, Sequence[Any], int]] = {}
    try:
        while True:
            processors = max(1, int(ray.cluster_resources().get("CPU", 0)))  # a node may come
            size = min(size, math.ceil(left / (2 * processors)))  # else the last tasks would be late
            while len(running) < QUEUED * processors:
                job, deaths = again.pop() if again else (None, 0)
                part: Sequence[Any] = [job] if deaths else list(islice(fresh, size))
                if not part:
                    break
                left -= 0 if deaths else len(part)
                reference = task.remote(expected, work, part)
                running[reference.future()] = reference, part, deaths
            if not running:
                return
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            lost = 0
            for one in done:
                _, part, deaths = running.pop(one)
                found = _fetch(ray, one)
                if found is None:
                    lost += 1
                    if deaths + 1 >= MOST_DEATHS:
                        raise WorkersDied
                    again += [(job, deaths + 1) for job in part]
                    continue
                job_s = found.busy_s / len(part)
                size = max(1, min(int(TASK_S / max(job_s, 1e-9)), 2 * len(part)))
                for outcome in found.outcomes:
                    yield outcome.unwrap()
            if lost:
                print("workers died; their work items are repeated", file=sys.stderr, flush=True)
    finally:
        for reference, *_ in running.values():
            ray.cancel(reference, force=True)


def _fetch(ray: Any, one: Future[Any]) -> TaskOutcome | None:
    """Fetch what came of a task, None if its node died; BadRequest if a node differs, or ClusterFailed."""
    errors = ray.exceptions
    try:
        found: TaskOutcome = one.result()
    except errors.RayTaskError as error:
        raise BadRequest(
            f"cluster: a node cannot load a task ({_first_line(error.cause or error)}); install the "
            "software of this machine on it"
        ) from error
    except (
        errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError, errors.ObjectLostError,
    ):  # fmt: skip
        return None
    except errors.RayError as error:
        raise ClusterFailed(
            f"cluster: Ray cannot carry out a task ({_first_line(error)}); see `ray status`"
        ) from error
    if found.difference:
        raise BadRequest(f"cluster: node {found.host} has {found.difference}; make it equal to this machine")
    return found


def carry_out_there(expected: Description, work: Callable[[Any], Any], jobs: Sequence[Any]) -> TaskOutcome:
    """Carry out the jobs of a task in a worker of the cluster, up to the first that raises an error."""
    found, host = describe_computer(_list_packages(work)), platform.node()
    wrong = [
        f"{name} {found[name]} and not {expected[name]}" for name in expected if found[name] != expected[name]
    ]
    if wrong:
        return TaskOutcome(host, [], 0.0, ", ".join(wrong))
    began_s, outcomes = time.perf_counter(), []
    for job in jobs:
        outcomes.append(attempt(work, job))
        error = outcomes[-1].error
        if isinstance(error, UserError | RobotError):
            outcomes[-1] = Outcome(None, BadRequest(f"node {host}: {error}"))
        if error is not None:
            break
    return TaskOutcome(host, outcomes, time.perf_counter() - began_s)


def _list_packages(work: Callable[[Any], Any]) -> tuple[str, ...]:
    """List the packages whose sources decide the results of a function."""
    own = getattr(work, "work", work).__module__.partition(".")[0]
    return (*SOURCES, own) if own == "validation" else SOURCES


@cache
def describe_computer(packages: tuple[str, ...] = SOURCES) -> Description:
    """Describe all on which the bits of a result depend, by name."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    found |= {name: version(name) for name in PACKAGES}
    return found | {"sources": digest_sources(packages), "arithmetic": _digest_arithmetic()}


def digest_sources(packages: tuple[str, ...]) -> str:
    """Compute the SHA-256 of programs and models, cut to a length that a person can compare."""
    total = hashlib.sha256()
    for name in packages:
        folder = Path(str(import_module(name).__path__[0]))
        found = (Path(at, file) for at, _, files in os.walk(folder, followlinks=True) for file in files)
        for path in sorted(path for path in found if path.suffix in SUFFIXES):
            total.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return total.hexdigest()[:12]


def _digest_arithmetic() -> str:
    """Compute the SHA-256 of functions that processors and libraries round differently."""
    x = np.linspace(0.01, 3.0, 4096)
    functions = (np.sin, np.cos, np.tan, np.arctan, np.exp, np.log, np.sqrt)
    square = np.sin(np.outer(x[:48], x[-48:]) * 50.0) + 4.0 * np.eye(48)
    parts = [f(x) for f in functions] + [square @ square, np.linalg.solve(square, x[:48])]
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:12]
