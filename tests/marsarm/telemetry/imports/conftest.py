"""Recorded run as a table, exported without the project, so that imports are compared with the log itself."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from fsw.dictionary.commands import MoveJoints, Stop
from fsw.estimate.reference import Reference
from marsarm.telemetry.imports.targets import known_targets
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import Recorder
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.world import World
from tests.sim.lab import true_reference

N_CYCLES = 192
ASKED = {8: MoveJoints((0.01, -0.01, 0.02, 0.0, 0.05), relative=True), 150: Stop()}


def reference() -> Reference:
    return true_reference(arm_named("nominal", None))


def recorded(path: Path) -> Log:
    """Return the log of three seconds of the nominal arm: it moves, and is stopped."""
    arm = arm_named("nominal", None)
    loop = ClosedLoop(
        Setup(arm, World("mars"), arm.params.poses.ready_rad, reference=reference()), with_truth=True
    )
    with Recorder(path, {"arm": "nominal"}) as recorder:
        for tick in range(N_CYCLES):
            recorder.write(loop.cycle((ASKED[tick],) if tick in ASKED else ()))
    return read_log(path)


def exported(log: Log) -> dict[str, Any]:
    """Return a column for each number of the log, and the time; empty where a topic has no message."""
    n = N_CYCLES
    columns: dict[str, Any] = {"t": pa.array(np.arange(n) / 64)}
    for name, target in known_targets().items():
        ticks, packets = log.ticks(target.topic), log[target.topic]
        values = packets[target.field.name].reshape(len(packets), -1)
        absent = ~np.isin(np.arange(n), ticks)
        for k in range(values.shape[1]):
            full = np.zeros(n, values.dtype)
            full[ticks] = values[:, k]
            columns[f"{name}.{k}"] = pa.array(full, mask=absent)
    return columns


def channels(*names: str) -> str:
    """Return the part of a mapping with some flight channels, or all, as `exported` writes them."""
    known = known_targets()
    text = ""
    for name in names or known:
        target = known[name]
        unit = {"degC": "degC"}.get(target.unit or "", target.unit)
        columns = [f"{name}.{k}" for k in range(target.size)]
        text += f'\n[[channel]]\nname = "{name}"\ncolumns = {json.dumps(columns)}\n'
        text += f'unit = "{unit}"\n' if target.members is None else ""
    return text


def start() -> str:
    """Return the part of a mapping with start conditions and commands of flight software."""
    known = reference()
    arrays = {
        f: getattr(known, f) for f in ("calibrated", "zero_rad", "half_backlash_rad", "resolver_bias_rad")
    }
    arrays["friction_Nm"] = known.friction_Nm
    lines = "\n".join(f"{name} = {json.dumps(array.tolist())}" for name, array in arrays.items())
    return f"""
[start]
mode = "deployed"
[start.reference]
{lines}
[[command]]
type = "MOVE_JOINTS"
at_s = {8 / 64}
angle_rad = {list(ASKED[8].angle_rad)}
relative = true
[[command]]
type = "STOP"
at_s = {150 / 64}
"""


TIME = '[time]\ncolumn = "t"\nunit = "s"\n'


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return recorded(tmp_path_factory.mktemp("run") / "run.mcap")


@pytest.fixture(scope="session")
def columns(run: Log) -> dict[str, Any]:
    return exported(run)


@pytest.fixture(scope="session")
def as_parquet(columns: dict[str, Any]) -> bytes:
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.table(columns), sink)
    return bytes(sink.getvalue())


@pytest.fixture(scope="session")
def make() -> Any:
    """Return this module, for tests."""
    return sys.modules[__name__]
