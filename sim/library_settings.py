"""Settings of the MuJoCo library in a process that runs plants: no file of warnings, no profiler.

MuJoCo would write its warnings to a file in the current directory; `Plant.step` checks their count. Its
profiler reads a clock many times in each step, and nothing here reads the profile.
"""

import ctypes

import mujoco


def apply_settings() -> None:
    """Apply the settings; a build of MuJoCo that does not show its clock keeps the profiler."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        clock = ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._structs.__file__), "mjcb_time")
    except (AttributeError, OSError, ValueError):
        return
    # mujoco.set_mjcb_time(None) would set the clock of the Python package again
    clock.value = None
