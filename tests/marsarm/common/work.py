"""Work that a node of a cluster can load: short, slow, deadly for its process, and interrupted."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simgap.common.errors import BadRequest


def square(x: int) -> int:
    return x * x


def square_or_fail(x: int) -> int:
    if x == 900:
        raise BadRequest("900 is not allowed")
    return x * x


def power(x: int, y: int) -> int:
    return x**y


def die_once(folder: Path) -> int:
    """Kill the worker that does this first."""
    try:
        (folder / "died").mkdir()
    except FileExistsError:
        return os.getpid()
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def node_id(_: int) -> str:
    import ray

    time.sleep(0.3)
    return str(ray.get_runtime_context().get_node_id())


def rest(_: int) -> None:
    time.sleep(60)


class Stop(BaseException):
    """Interruption."""


@contextmanager
def interrupted_after(seconds: float) -> Iterator[None]:
    """Expect that the block is interrupted after this time."""

    def interrupt(*_: object) -> None:
        raise Stop

    import pytest  # which every worker would load

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        with pytest.raises(Stop):
            yield
    finally:
        signal.signal(signal.SIGALRM, before)
