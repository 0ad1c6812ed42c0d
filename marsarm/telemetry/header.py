"""Header of a log: software, processor, start conditions of flight software, commands and plant."""

import ctypes
import hashlib
import json
import platform
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy._core._multiarray_umath import __cpu_features__ as NUMPY_FEATURES  # type: ignore[import-not-found]

from fsw.dictionary.commands import Command
from fsw.dictionary.digest import digest
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.format import WRITER_KEY
from sim.effects.effect import Effect
from sim.loop import ClosedLoop
from sim.scenario.effects import effect_text
from sim.setting import World
from simgap.common.origin import git_revision


@cache
def cpu_features() -> tuple[str, ...]:
    """Return the machine, the instruction sets that numpy uses, and the kernels of its OpenBLAS."""
    features = sorted(name for name, is_used in NUMPY_FEATURES.items() if is_used)
    return (platform.machine(), *features, f"OpenBLAS {_blas_kernels()}")


def _blas_kernels() -> str:
    """Return the kernels of OpenBLAS, which decide the last digits of sums; "unknown" for another library."""
    folder = Path(np.__file__).parents[1] / "numpy.libs"
    for library in sorted(folder.glob("libscipy_openblas*")):
        try:
            core_name = ctypes.CDLL(str(library)).scipy_openblas_get_corename64_
        except (OSError, AttributeError):
            continue
        core_name.restype = ctypes.c_char_p
        return str(core_name().decode())
    return "unknown"


WORLD: Final = "world"
"""Key of the header: scene, tilt of the rover and surface as JSON, for viewers."""
SESSION: Final = "session"
"""Key of the header: motion and conditions of a session as JSON, for the diagnosis."""
IMPORT: Final = "import"
"""Key of the request of a log that was made of a table: its files and their digests."""


def run_header(
    loop: ClosedLoop,
    arm: str,
    seed: int,
    request: dict[str, Any],
    commands: Sequence[Command],
    effects: Sequence[Effect] = (),
    world: World | None = None,
) -> dict[str, str]:
    """Return the header of a run that has not begun; effects are those beyond the arm's.

    Raises:
        ValueError: the run has begun, so the start conditions are no longer known.
    """
    return {
        **flight_header(loop, commands),
        "arm": arm,
        "seed": str(seed),
        "request": json.dumps(request, default=str, sort_keys=True),
        "effects": json.dumps([effect_text(effect) for effect in effects]),
        "mjcf_sha256": model_digest(loop.plant.model),
        **({} if world is None else {WORLD: json.dumps(record_to_json(world))}),
    }


def flight_header(loop: ClosedLoop, commands: Sequence[Command]) -> dict[str, str]:
    """Return the part of the header that knows nothing of the plant: versions, start conditions and commands.

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
    """Return the versions of the software, and the processor."""
    return {
        WRITER_KEY: version("marsarm"),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "cpu": json.dumps(cpu_features()),
        "git": git_revision(),
    }


def start_header(params: Params, mode: Mode, reference: Reference | None) -> dict[str, str]:
    """Return the start conditions of flight software: all that replay needs besides sensors and commands."""
    boot = {"mode": mode.name, "reference": None if reference is None else record_to_json(reference)}
    return {
        "params": json.dumps(record_to_json(params)),
        "params_sha256": digest(params),
        "boot": json.dumps(boot),
    }


def commands_header(commands: Sequence[Command]) -> dict[str, str]:
    """Return a command sequence and its digest."""
    text = json.dumps([{"type": type(c).__name__, "fields": record_to_json(c)} for c in commands])
    return {"commands": text, "commands_sha256": hashlib.sha256(text.encode()).hexdigest()}


def model_digest(model: mujoco.MjModel) -> str:
    """Compute the SHA-256 of the compiled plant: models/mjcf, the world and the effects."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.data).hexdigest()
