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
    clock = ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._structs.__file__), "mjcb_time")
    before = clock.value
    clock.value = None
    try:
        yield
    finally:
        clock.value = before
