"""Sensitivities of the arm's simulator: differences of what each effect can touch, on several cores; kept."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

import fsw
import sim
from fsw.config import digest
from fsw.kinematics.transforms import Array
from ground.common.files import atomic_write
from ground.common.pool import Runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.arm.audit import believed
from ground.diagnosis.arm.bound import keys_of
from ground.diagnosis.arm.campaign import compared
from ground.diagnosis.arm.columns import (
    Column,
    Side,
    alike,
    columns_of,
    sides_at,
    sides_of,
    size_of,
    slopes_from,
    together,
)
from ground.diagnosis.arm.floor import floor_of
from ground.diagnosis.arm.simulator import ArmSimulator, arm_simulator
from ground.diagnosis.arm.step import ROUNDS, mended, off
from ground.diagnosis.layout import Layout
from ground.diagnosis.prepared import prepare
from ground.diagnosis.sensitivity import Sensitivities, load, save, through
from ground.telemetry.header import model_digest
from sim.effects.catalogue import catalogue
from sim.params import nominal_params
from sim.world import World, build

Logs = tuple[Path, ...]
Names = tuple[str, ...]
_NAMES: Final = TypeAdapter(Names)


COMPARE: Final = (
    "ground.calibration.screws",
    "ground.diagnosis.hypothesis",
    "ground.diagnosis.layout",
    "ground.diagnosis.prepared",
    "ground.diagnosis.sensitivity",
    "ground.diagnosis.whiten",
)
"""Modules beyond the simulator and this package that have a part in it."""
NEARLY: Final = 0.1
"""Of the difference to half the time step, what remains of the plant's numerics when it is fitted."""


@dataclass(frozen=True, slots=True)
class _Job:
    logs: Logs
    kinds: Names
    columns: tuple[int, ...]
    """That are simulated at once."""
    side: int
    shares: tuple[float, ...]
    nominal: Array
    """What the simulator has without effects, (m,)."""


@dataclass(frozen=True, slots=True, eq=False)
class OnFile:
    """Sensitivities, and where they are kept; what else is known of a campaign is kept beside."""

    found: Sensitivities
    path: Path

    def keys(self) -> Names:
        """The names of the rows; BadRequest if they are not there, or are other than so many."""
        return keys_in(self.path, self.found.layout.size)


def arm_sensitivities(
    logs: Sequence[Path], kept_in: Path, run: Runner, progress: Progress, kinds: Sequence[str] | None = None
) -> OnFile:
    """Those of a campaign's logs for these effects of the catalogue, all by default; from a file if there is.

    The file's name has the digest of logs, model and catalogue in it; any change makes another file.

    Raises:
        NotForDiagnosis: a log cannot be compared.
        BadRequest: what is kept cannot be read, or the folder cannot be made.
        BadOutput: a file cannot be written.
    """
    paths, names = tuple(sorted(logs)), tuple(catalogue() if kinds is None else kinds)
    path = kept_in / _file(paths, names)
    if path.exists():
        return OnFile(_kept(path), path)
    _check_folder(kept_in)
    whole = kept_in / _file(paths, tuple(catalogue()))
    if whole.exists():
        return _part(OnFile(_kept(whole), whole), names, path)
    result = _found(paths, names, run, progress)
    return _keep(result, keys_of(_simulator(paths, names).campaign), path)


def _file(logs: Logs, kinds: Names) -> str:
    return f"sensitivities-{campaign_digest(logs, kinds)[:16]}.npz"


def _part(whole: OnFile, names: Names, path: Path) -> OnFile:
    """Of some effects alone, from those of all."""
    return _keep(whole.found.only(names), whole.keys(), path)


def _keep(found: Sensitivities, keys: Sequence[str], path: Path) -> OnFile:
    with atomic_write(keys_path(path), "keys") as file:
        file.write(json.dumps(keys).encode())
    save(path, found)
    return OnFile(found, path)


def _found(paths: Logs, names: Names, run: Runner, progress: Progress) -> Sensitivities:
    """One side of every column, mended until it can be seen well, and the other side by the same steps.

    What has its slope from a nuisance stays as it is: no step of its own makes it seen better.
    """
    simulator = _simulator(paths, names)
    columns = columns_of(simulator)
    same, given = alike(simulator, columns), slopes_from(simulator, columns)
    nominal = _nominal(paths, names)

    def simulated(shares: Mapping[int, float], side: int, what: str) -> dict[int, Side]:
        at_once = together(simulator, columns, sorted(shares))
        jobs = [_Job(paths, names, of, side, tuple(shares[k] for k in of), nominal) for of in at_once]
        found: dict[int, Side] = {}
        for done, some in enumerate(run(_worked, jobs), 1):
            found |= some
            progress(done, len(jobs), what)
        return found

    up = simulated({k: 1.0 for k in range(len(columns)) if k not in same}, 0, "sensitivities")
    last, best = up, dict.fromkeys(up, math.inf)
    for attempt in range(ROUNDS + 1):
        scale = prepare(_assembled(paths, names, last, {})).scale
        seen = {k: float(by) * abs(last[k].size) for k, by in enumerate(scale) if k not in given}
        nearer = [k for k in seen if off(seen[k]) < best[k]]
        up |= {k: last[k] for k in nearer}
        best |= {k: off(seen[k]) for k in nearer}
        better = _mended(simulator, columns, last, seen) if attempt < ROUNDS else {}
        if not better:
            break
        last = {**last, **simulated(better, 0, "better steps")}
    down = {k: side.share for k, side in up.items() if sides_of(simulator, columns[k]) > 1}
    return _assembled(paths, names, up, simulated(down, 1, "other sides"))


def _mended(
    simulator: ArmSimulator, columns: Sequence[Column], last: Mapping[int, Side], seen: Mapping[int, float]
) -> dict[int, float]:
    """Better shares, of columns that are seen too little or too well."""
    found: dict[int, float] = {}
    for k, by in seen.items():
        share = mended(last[k].share, by)
        if share is not None and size_of(simulator, columns[k], share) != last[k].size:
            found[k] = share
    return found


def _assembled(paths: Logs, names: Names, up: Mapping[int, Side], down: Mapping[int, Side]) -> Sensitivities:
    """Parabolas through what was simulated, or lines where that is one side.

    Of a hypothesis that is a nuisance as well only the bend is: the slope is that of the nuisance's sigma.
    """
    simulator = _simulator(paths, names)
    columns = columns_of(simulator)
    slope, bend = np.zeros((2, simulator.layout.size, len(columns)))
    reach = np.ones(len(columns))
    for k, side in up.items():
        sides = [side, down[k]] if k in down else [side]
        slope[:, k], bend[:, k] = through([(one.change, one.size) for one in sides])
        reach[k] = max(abs(one.size) for one in sides)
    for k, (other, typical) in alike(simulator, columns).items():
        slope[:, k] = slope[:, other] / typical
    for k, (other, typical) in slopes_from(simulator, columns).items():
        slope[:, k] = slope[:, other] * typical
    owner = [column.hypothesis for column in columns if column.hypothesis is not None]
    sized = len(owner)
    nuisance = _cut(simulator, slope[:, sized:])
    return Sensitivities(
        _doubting(simulator, nuisance),
        simulator.hypotheses,
        simulator.nuisances,
        _nominal(paths, names),
        slope[:, :sized],
        bend[:, :sized],
        reach[:sized],
        np.array(owner, np.intp),
        nuisance,
    )


def _cut(simulator: ArmSimulator, column: Array) -> Array:
    """Nuisances (m, q) of their columns: where they show alone, and what they are more beside others."""
    uncertain = simulator.uncertain
    plain = {one.effect(1.0): k for k, one in enumerate(uncertain) if one.at and not one.beside}
    cut = column.copy()
    for k, one in enumerate(uncertain):
        if one.beside:
            cut[:, k] -= column[:, plain[one.effect(1.0)]]
        if one.at:
            elsewhere = [simulator.layout.places[place] != one.at for place in simulator.layout.place]
            cut[elsewhere, k] = 0.0
    return cut


def _doubting(simulator: ArmSimulator, nuisance: Array) -> Layout:
    """The floor, with a share of what the plant's own numerics are off by: they fit but nearly."""
    own = nuisance[:, [k for k, one in enumerate(simulator.uncertain) if one.at]]
    sigma = np.sqrt(simulator.layout.sigma**2 + np.sum((NEARLY * own) ** 2, axis=1))
    return replace(simulator.layout, sigma=sigma)


def keys_path(path: Path) -> Path:
    """Where the names of a sensitivity file's rows are."""
    return path.with_suffix(".keys.json")


def keys_in(path: Path, rows: int) -> Names:
    """The names of a sensitivity file's rows; BadRequest if they are not there, or are other than so many."""
    keys, anew = keys_path(path), f"remove {path}, and both are made anew"
    try:
        said = _NAMES.validate_json(keys.read_bytes(), strict=True)
    except OSError as error:
        raise BadRequest(f"{keys}: cannot be read ({error.strerror}); {anew}") from error
    except ValidationError as error:
        raise BadRequest(f"{keys}: cannot be read ({error.errors()[0]['msg']}); {anew}") from error
    if len(said) != rows:
        raise BadRequest(f"{keys}: names {len(said)} of {rows} rows; {anew}")
    return said


def _kept(path: Path) -> Sensitivities:
    try:
        return load(path)
    except ValueError as error:
        raise BadRequest(f"{error}; remove it, and they are computed anew") from error


def _check_folder(kept_in: Path) -> None:
    try:
        kept_in.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadRequest(f"{kept_in}: no sensitivities can be kept there ({error.strerror})") from error


def campaign_digest(logs: Logs, kinds: Names) -> str:
    """SHA-256 of all that they depend on: logs, parameters, model, and what simulates and compares."""
    total = hashlib.sha256("\n".join(kinds).encode())
    for path in logs:
        total.update(path.read_bytes())
        tracker = path.with_suffix(".tracker.csv")
        total.update(tracker.read_bytes() if tracker.exists() else b"")
    total.update(digest(nominal_params()).encode())
    total.update(model_digest(build(World()).compile()).encode())
    own = (
        *sorted(Path(__file__).parent.glob("*.py")),
        *(Path(str(import_module(name).__file__)) for name in COMPARE),
    )
    for source in (*sources_in(fsw), *sources_in(sim), *own):
        total.update(source.read_bytes())
    return total.hexdigest()


def sources_in(package: ModuleType) -> list[Path]:
    """All its modules."""
    return sorted(Path(package.__path__[0]).rglob("*.py"))


@cache
def _simulator(logs: Logs, kinds: Names) -> ArmSimulator:
    """Once in each process."""
    campaign = compared(believed(logs))
    return arm_simulator(campaign, floor_of(campaign).sigma, {name: catalogue()[name] for name in kinds})


@cache
def _nominal(logs: Logs, kinds: Names) -> Array:
    return _simulator(logs, kinds).predicted(())


def _worked(job: _Job) -> dict[int, Side]:
    simulator = _simulator(job.logs, job.kinds)
    every = columns_of(simulator)
    sides = sides_at(simulator, [every[k] for k in job.columns], job.nominal, job.side, job.shares)
    return dict(zip(job.columns, sides, strict=True))
