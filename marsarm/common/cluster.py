"""Workers of a Ray cluster.

Each node must have the software of this machine, and compute the same bits; each worker is asked with its
first task. Ray is optional, and imported only here.
"""

import atexit
import hashlib
import logging
import math
import os
import platform
import signal
import socket
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import cache, partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from marsarm.common.pool import Executor, TaskOutcome, carry_out
from simgap.common.errors import BadRequest, RobotError, UserError

PACKAGES: Final = ("numpy", "scipy", "mujoco-core", "ruckig", "ray")
"""Packages whose version changes results, or how they are sent."""
SOURCES: Final = ("fsw", "sim", "simgap", "marsarm")
SUFFIXES: Final = (".py", ".toml", ".xml")
COUNT_PERIOD_S: Final = 1.0
"""Time after which the processors of the cluster are counted again."""
CONNECT_S: Final = 5.0
"""Time in which the head of a cluster has to answer."""
QUEUED: Final = 2
"""Tasks for each processor: one that runs, and one that waits at its node while results travel."""

Description = dict[str, str]


class ClusterFailed(UserError):
    """Error of Ray that a repetition of the task would not mend."""

    exit_status = 1


def connect(address: str) -> Callable[[], Executor]:
    """Connect to a cluster; return a function that makes an executor on it.

    Raises:
        BadRequest: Ray is not installed, or no cluster answers at the address.
    """
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
            _check_answers(_find_head(address))
            # Ray writes the logs of a node that died to standard output, where JSON documents go.
            ray._private.worker.listen_error_messages = lambda *_: None
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            atexit.register(ray.shutdown)  # that of ray itself first sleeps for half a second
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise BadRequest(
                f"cluster {address}: cannot be used ({_first_line(error)}); give HOST:PORT of a head that "
                "`ray start --head` started, on one of its nodes"
            ) from error
        finally:
            signal.signal(signal.SIGTERM, before)  # ray replaces it
    return partial(ClusterWorkers, ray)


def _find_head(address: str) -> str:
    """Find host and port of the head, as ray does."""
    from ray._private.services import canonicalize_bootstrap_address

    found: str | None = canonicalize_bootstrap_address(address)
    if found is None:
        raise ConnectionError("no cluster runs on this machine, and RAY_ADDRESS names none")
    return found


def _check_answers(head: str) -> None:
    """Raise a ConnectionError if nothing listens there; ray would try for minutes."""
    host, _, port = head.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise ConnectionError(f"nothing answers at {head}") from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0].rstrip(".")


class ClusterWorkers:
    """Executor on the cluster to which this process is connected."""

    def __init__(self, ray: Any) -> None:
        self._ray = ray
        self._task = ray.remote(num_cpus=1, max_retries=0)(carry_out_there)
        self._running: dict[Future[Any], tuple[int, Any]] = {}
        """Number and reference of a task. Ray's own wait is not used: it holds back signals."""
        self._workers, self._counted_s = 1, -math.inf

    @property
    def workers(self) -> int:
        """Return the number of processors of the nodes that are alive; at least 1, as a node may come."""
        now_s = time.monotonic()
        if now_s > self._counted_s + COUNT_PERIOD_S:
            self._counted_s = now_s
            self._workers = max(1, int(self._ray.cluster_resources().get("CPU", 0)))
        return self._workers

    @property
    def room(self) -> int:
        """Return the number of tasks that may be submitted now."""
        return QUEUED * self.workers - len(self._running)

    def submit(self, number: int, work: Callable[[Any], Any], jobs: Sequence[Any]) -> None:
        """Send a task to the cluster."""
        description = describe_computer(_list_packages(work))
        reference = self._task.remote(description, work, jobs)
        self._running[reference.future()] = number, reference

    def wait(self) -> list[tuple[int, TaskOutcome | None]]:
        """Wait until tasks end; None for the outcome of one whose worker or node died."""
        done, _ = wait(self._running, return_when=FIRST_COMPLETED)
        return [(self._running.pop(one)[0], self._fetch(one)) for one in done]

    def stop(self) -> None:
        """Kill all tasks."""
        for _, reference in self._running.values():
            self._ray.cancel(reference, force=True)
        self._running.clear()

    def _fetch(self, one: Future[Any]) -> TaskOutcome | None:
        """Fetch an outcome.

        Returns:
            The outcome, with an error if Ray cannot carry out the task; None if its worker or node died.

        Raises:
            BadRequest: A node cannot load the software, or differs from this machine.
        """
        errors = self._ray.exceptions
        died = (
            errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError, errors.ObjectLostError,
        )  # fmt: skip
        try:
            host, found = one.result()
        except errors.RayTaskError as error:
            raise BadRequest(
                f"cluster: a node cannot load a task ({_first_line(error.cause or error)}); install the "
                "software of this machine on it"
            ) from error
        except died:
            return None
        except errors.RayError as error:
            sentence = f"cluster: Ray cannot carry out a task ({_first_line(error)}); see `ray status`"
            return TaskOutcome([], 0.0, ClusterFailed(sentence))
        if isinstance(found, str):
            raise BadRequest(f"cluster: node {host} {found}; make it equal to this machine")
        assert isinstance(found, TaskOutcome)
        if isinstance(found.error, UserError | RobotError):
            return TaskOutcome(found.results, found.busy_s, BadRequest(f"node {host}: {found.error}"))
        return found


def carry_out_there(
    expected: Description, work: Callable[[Any], Any], jobs: Sequence[Any]
) -> tuple[str, TaskOutcome | str]:
    """Carry out a task in a worker of the cluster.

    Returns:
        The name of the node, and the outcome, or how the node differs from the machine that asks.
    """
    found = describe_computer(_list_packages(work))
    wrong = [
        f"{name} {found[name]} and not {expected[name]}" for name in expected if found[name] != expected[name]
    ]
    return platform.node(), f"has {', '.join(wrong)}" if wrong else carry_out(work, jobs)


def _list_packages(work: Callable[[Any], Any]) -> tuple[str, ...]:
    """List the packages whose sources decide the results of a function."""
    own = getattr(work, "work", work).__module__.partition(".")[0]
    return (*SOURCES, own) if own == "validation" else SOURCES


@cache
def describe_computer(packages: tuple[str, ...] = SOURCES) -> Description:
    """Describe all on which the bits of a result depend, by name."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    found |= {name: version(name) for name in PACKAGES}
    return found | {"sources": _digest_sources(packages), "arithmetic": _digest_arithmetic()}


def _digest_sources(packages: tuple[str, ...]) -> str:
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
