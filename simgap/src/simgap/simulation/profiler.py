"""The profiler of MuJoCo, which reads a clock several times in each step."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def profiler_off() -> Iterator[None]:
    """Switch the profiler off, as it is in the C library; the Python package switches it on.

    It takes a quarter of the time of a step of one joint. No bit of a simulation depends on it.
    `mujoco.set_mjcb_time(None)` would switch it on again, so the pointer itself is set.
    """
    try:
        clock = ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._structs.__file__), "mjcb_time")
    except (AttributeError, OSError, ValueError):  # another build of MuJoCo: its steps only take longer
        yield
        return
    before = clock.value
    try:
        clock.value = None
        yield
    finally:
        clock.value = before
