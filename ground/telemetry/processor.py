"""What decides how this machine rounds sums: its instruction sets, and the kernels chosen by them."""

import ctypes
import platform
from functools import cache
from pathlib import Path

import numpy as np
from numpy._core._multiarray_umath import (  # type: ignore[import-not-found]
    __cpu_features__ as NUMPY_FEATURES,
)


@cache
def cpu_features() -> tuple[str, ...]:
    """The machine, the instruction sets that numpy makes use of, and whose kernels its OpenBLAS does."""
    used = sorted(name for name, there in NUMPY_FEATURES.items() if there)
    return (platform.machine(), *used, f"OpenBLAS {_kernels()}")


def _kernels() -> str:
    """Other kernels are what changes last digits; "unknown" where numpy has another linear algebra."""
    folder = Path(np.__file__).parents[1] / "numpy.libs"
    for library in sorted(folder.glob("libscipy_openblas*")):
        try:
            core_name = ctypes.CDLL(str(library)).scipy_openblas_get_corename64_
        except (OSError, AttributeError):
            continue
        core_name.restype = ctypes.c_char_p
        return str(core_name().decode())
    return "unknown"
