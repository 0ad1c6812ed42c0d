"""Sensitivities of the arm's simulator: differences of what each effect can touch, on several cores; kept."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import sim.effects
from fsw.config import digest
from fsw.kinematics.transforms import Array
from ground.gap.arm.bound import first_of_block, keys_of, repeated
from ground.gap.arm.campaign import compared
from ground.gap.arm.features import Moving
from ground.gap.arm.floor import floor_of
from ground.gap.arm.logs import recording_in
from ground.gap.arm.simulator import ArmSimulator, Touched, all_of
from ground.gap.hypothesis import Hypothesis
from ground.gap.sensitivity import Sensitivities, load, save, through
from ground.pool import Runner
from ground.progress import Progress
from ground.telemetry.header import model_digest
from sim.effects.catalogue import catalogue
from sim.params import nominal_params
from sim.world import World, build

Logs = tuple[Path, ...]
Names = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Column:
    """A number whose sensitivity is wanted: a size parameter of a hypothesis, or a nuisance."""

    hypothesis: int | None
    at: int
    """Which of the hypothesis' parameters; of a nuisance, which one."""


@dataclass(frozen=True, slots=True)
class _Job:
    logs: Logs
    kinds: Names
    column: int


def arm_sensitivities(
    logs: Sequence[Path], kept_in: Path, run: Runner, progress: Progress, kinds: Sequence[str] | None = None
) -> Sensitivities:
    """Those of a campaign's logs for these effects of the catalogue, all by default; from a file if there is.

    The file's name has the digest of logs, model and catalogue in it; any change makes another file.
    """
    paths, names = tuple(sorted(logs)), tuple(catalogue() if kinds is None else kinds)
    path = kept_path(logs, kept_in, kinds)
    if path.exists():
        return load(path)
    simulator = _simulator(paths, names)
    columns = columns_of(simulator)
    alike = _alike(simulator, columns)
    jobs = [_Job(paths, names, k) for k in range(len(columns)) if k not in alike]
    found, curve = np.zeros((2, simulator.layout.size, len(columns)))
    for done, (column, (slope, bend)) in enumerate(run(_worked, jobs), 1):
        found[:, column], curve[:, column] = slope, bend
        progress(done, len(jobs), "sensitivities")
    for number, (other, typical) in alike.items():
        found[:, number] = found[:, other] / typical
    effects = [k for k, column in enumerate(columns) if column.hypothesis is not None]
    owner = np.array([columns[k].hypothesis for k in effects], np.intp)
    result = Sensitivities(
        simulator.layout,
        simulator.hypotheses,
        simulator.nuisances,
        _nominal(paths, names),
        found[:, effects],
        curve[:, effects],
        owner,
        found[:, len(effects) :],
    )
    kept_in.mkdir(parents=True, exist_ok=True)
    save(path, result)
    keys_path(path).write_text(json.dumps(keys_of(simulator.campaign)), encoding="utf-8")
    return result


def kept_path(logs: Sequence[Path], kept_in: Path, kinds: Sequence[str] | None = None) -> Path:
    """Where the sensitivities of these logs are kept."""
    paths, names = tuple(sorted(logs)), tuple(catalogue() if kinds is None else kinds)
    return kept_in / f"sensitivities-{campaign_digest(paths, names)[:16]}.npz"


def keys_path(path: Path) -> Path:
    """Where the names of a sensitivity file's rows are."""
    return path.with_suffix(".keys.json")


def campaign_digest(logs: Logs, kinds: Names) -> str:
    """SHA-256 of all that they depend on: logs, parameters, model, effects, and this adapter."""
    total = hashlib.sha256("\n".join(kinds).encode())
    for path in logs:
        total.update(path.read_bytes())
        tracker = path.with_suffix(".tracker.csv")
        total.update(tracker.read_bytes() if tracker.exists() else b"")
    total.update(digest(nominal_params()).encode())
    total.update(model_digest(build(World()).compile()).encode())
    for folder in (sim.effects.__path__[0], Path(__file__).parent):
        for source in sorted(Path(folder).glob("*.py")):
            total.update(source.read_bytes())
    return total.hexdigest()


def columns_of(simulator: ArmSimulator) -> list[Column]:
    """Every size parameter of every hypothesis in order, then the nuisances."""
    sized = [
        Column(k, at)
        for k, hypothesis in enumerate(simulator.hypotheses)
        for at, parameter in enumerate(hypothesis.parameters)
        if parameter.sizes
    ]
    return sized + [Column(None, k) for k in range(len(simulator.nuisances))]


def _alike(simulator: ArmSimulator, columns: Sequence[Column]) -> dict[int, tuple[int, float]]:
    """Nuisances that a hypothesis says too: by column, that one's column and its typical size."""
    known: dict[str, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is not None:
            hypothesis = simulator.hypotheses[column.hypothesis]
            known[hypothesis.name] = k, hypothesis.parameters[column.at].typical
    said = {k: simulator.likes[column.at] for k, column in enumerate(columns) if column.hypothesis is None}
    return {k: known[name] for k, name in said.items() if name in known}


def column_of(simulator: ArmSimulator, column: Column, nominal: Array) -> tuple[Array, Array]:
    """Change of the features (m,) per typical size or unit of a nuisance, and per its square: a parabola.

    Through three points; where bounds leave but one side, a straight line.

    Of repeats only the first is simulated: the others were given the same drive.
    """
    ends = [(simulator.effects(settings, by), size) for settings, by, size in _ends(simulator, column)]
    touched = Touched(tuple(e for effects, _ in ends for e in effects[len(simulator.patch) :]))
    known = first_of_block(simulator.campaign)

    def wanted(one: Moving) -> bool:
        return one.recording.name in known and touched(one)

    changes = [(simulator.predicted(effects, wanted) - nominal, size) for effects, size in ends]
    slope, bend = (repeated(simulator.campaign, known, values) for values in through(changes))
    return slope, bend


def _ends(
    simulator: ArmSimulator, column: Column
) -> Iterator[tuple[Mapping[Hypothesis, Array], Array, float]]:
    """Settings, nuisances and departure [typical sizes, units of the nuisance] on both sides of nominal."""
    zero = np.zeros(len(simulator.nuisances))
    for sign in (1.0, -1.0):
        if column.hypothesis is None:
            by = zero.copy()
            one_sided = simulator.one_sided[column.at]
            by[column.at] = 1.0 if one_sided else sign * simulator.nuisances[column.at].sigma
            if sign > 0.0 or not one_sided:
                yield {}, by, float(by[column.at])
            continue
        hypothesis = simulator.hypotheses[column.hypothesis]
        values = np.array([parameter.absent for parameter in hypothesis.parameters])
        parameter, absent = hypothesis.parameters[column.at], values[column.at]
        values[column.at] = np.clip(absent + sign * parameter.typical, parameter.least, parameter.most)
        if values[column.at] != absent:
            yield {hypothesis: values}, zero, float((values[column.at] - absent) / parameter.typical)


@cache
def _simulator(logs: Logs, kinds: Names) -> ArmSimulator:
    """Once in each process."""
    base = nominal_params()
    campaign = compared([recording_in(path) for path in logs], base)
    return ArmSimulator(campaign, base, floor_of(campaign).sigma, {name: catalogue()[name] for name in kinds})


@cache
def _nominal(logs: Logs, kinds: Names) -> Array:
    simulator = _simulator(logs, kinds)
    return simulator.predicted(simulator.patch, all_of)


def _worked(job: _Job) -> tuple[int, tuple[Array, Array]]:
    simulator = _simulator(job.logs, job.kinds)
    column = columns_of(simulator)[job.column]
    return job.column, column_of(simulator, column, _nominal(job.logs, job.kinds))
