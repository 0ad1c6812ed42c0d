"""What a log's header says of its run: what made it, and all that flight software began with."""

import ctypes
import hashlib
import json
import platform
import subprocess
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy._core._multiarray_umath import __cpu_features__ as NUMPY_FEATURES  # type: ignore[import-not-found]

from fsw.config import digest
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from ground.telemetry.json_codec import record_to_json
from sim.effects.effect import Effect
from sim.loop import ClosedLoop
from sim.scenario.effects import effect_text


@cache
def cpu_features() -> tuple[str, ...]:
    """The machine, the instruction sets that numpy makes use of, and whose kernels its OpenBLAS does."""
    used = sorted(name for name, there in NUMPY_FEATURES.items() if there)
    return (platform.machine(), *used, f"OpenBLAS {_blas_kernels()}")


def _blas_kernels() -> str:
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


REPOSITORY: Final = Path(__file__).resolve().parents[2]
GIT_TIMEOUT_S: Final = 5.0
SESSION: Final = "session"
"""Header key: what was done under which conditions, in JSON, for a diagnosis of the gap."""


def run_header(
    loop: ClosedLoop,
    arm: str,
    seed: int,
    request: dict[str, Any],
    commands: Sequence[Command],
    effects: Sequence[Effect] = (),
) -> dict[str, str]:
    """The header of a run that has not begun; `commands` is what it is going to be asked.

    `effects` are those that were switched on beyond what the arm's name says.

    Raises:
        ValueError: the run has begun; what flight software began with is gone.
    """
    return {
        **flight_header(loop, commands),
        "arm": arm,
        "seed": str(seed),
        "request": json.dumps(request, default=str, sort_keys=True),
        "effects": json.dumps([effect_text(effect) for effect in effects]),
        "mjcf_sha256": model_digest(loop.plant.model),
    }


def flight_header(loop: ClosedLoop, commands: Sequence[Command]) -> dict[str, str]:
    """The part of it that tells nothing of the plant: all that flight software began with and is asked.

    Raises:
        ValueError: the run has begun.
    """
    if loop.state.tick != 0:
        raise ValueError(f"the run is at tick {loop.state.tick}; a log begins with flight software's first")
    return {
        **versions_header(),
        **start_header(loop.config.params, loop.state.mode, loop.state.joints.reference),
        **commands_header(commands),
    }


def versions_header() -> dict[str, str]:
    """The software and the processor that make a log."""
    return {
        "marsarm": version("marsarm"),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "cpu": json.dumps(cpu_features()),
        "git": git_revision(),
    }


def start_header(params: Params, mode: Mode, reference: Reference | None) -> dict[str, str]:
    """All that flight software begins with: what replay needs beside sensors and commands.

    `reference` is what is remembered of the joints, None for nothing.
    """
    boot = {"mode": mode.name, "reference": None if reference is None else record_to_json(reference)}
    return {
        "params": json.dumps(record_to_json(params)),
        "params_sha256": digest(params),
        "boot": json.dumps(boot),
    }


def commands_header(commands: Sequence[Command]) -> dict[str, str]:
    """A command sequence and its digest."""
    text = json.dumps([{"type": type(c).__name__, "fields": record_to_json(c)} for c in commands])
    return {"commands": text, "commands_sha256": hashlib.sha256(text.encode()).hexdigest()}


def model_digest(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled plant: the files of models/mjcf, the world, and what effects made of them."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.data).hexdigest()


@cache
def git_revision() -> str:
    """The commit of this tree, "-dirty" appended if files of it are changed; "unknown" outside of git."""
    if not (REPOSITORY / ".git").exists():
        return "unknown"
    command = ["git", "-C", str(REPOSITORY), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()
