"""Sensitivities of the arm's simulator: differences of what each effect can touch, on several cores; kept."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

import fsw
import ground
import sim
from fsw.config import digest
from fsw.kinematics.transforms import Array, Flags
from ground.gap.arm.bound import changed, keys_of
from ground.gap.arm.campaign import compared
from ground.gap.arm.floor import floor_of
from ground.gap.arm.logs import recording_in
from ground.gap.arm.simulator import ONLY_POSED, ArmSimulator, arm_simulator
from ground.gap.layout import Layout
from ground.gap.sensitivity import Sensitivities, load, save, through
from ground.outputs import written_whole
from ground.pool import Runner
from ground.progress import Progress
from ground.request import BadRequest
from ground.telemetry.header import model_digest
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.params import nominal_params
from sim.world import World, build

Logs = tuple[Path, ...]
Names = tuple[str, ...]
_NAMES: Final = TypeAdapter(Names)


COMPARE: Final = ("calibration/screws.py", "gap/hypothesis.py", "gap/layout.py", "gap/sensitivity.py")
"""Modules beyond the simulator and this package that have a part in it."""
WANTED: Final = 60.0
"""Sigmas, of all features together and before nuisances, by which a step is to move them."""
TOO_MUCH: Final = 3.0
"""Of what is wanted: then a smaller step is tried."""
NEARLY: Final = 0.1
"""Of the difference to half the time step, what remains of the plant's numerics when it is fitted."""
TRIES: Final = 3
LEAST_SHARE: Final = 1e-3
"""Of a typical size, to begin with."""


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
    with written_whole(keys_path(path), "keys") as file:
        file.write(json.dumps(keys).encode())
    save(path, found)
    return OnFile(found, path)


def _found(paths: Logs, names: Names, run: Runner, progress: Progress) -> Sensitivities:
    """All columns, those that are alike simulated once."""
    simulator = _simulator(paths, names)
    columns = columns_of(simulator)
    alike = _alike(simulator, columns)
    jobs = [_Job(paths, names, k) for k in range(len(columns)) if k not in alike]
    slope, bend = np.zeros((2, simulator.layout.size, len(columns)))
    reach = np.ones(len(columns))
    for done, (column, one) in enumerate(run(_worked, jobs), 1):
        slope[:, column], bend[:, column], reach[column] = one.slope, one.bend, one.reach
        progress(done, len(jobs), "sensitivities")
    for number, (other, typical) in alike.items():
        slope[:, number] = slope[:, other] / typical
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
            cut[~_at(simulator.layout, one.at), k] = 0.0
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
        *(Path(ground.__path__[0]) / name for name in COMPARE),
    )
    for source in (*sources_in(fsw), *sources_in(sim), *own):
        total.update(source.read_bytes())
    return total.hexdigest()


def sources_in(package: ModuleType) -> list[Path]:
    """All its modules."""
    return sorted(Path(package.__path__[0]).rglob("*.py"))


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
    """Nuisances that are a hypothesis or another nuisance as well: that one's column, and what 1 is of it."""
    known: dict[str, tuple[int, float]] = {}
    alike: dict[int, tuple[int, float]] = {}
    for k, column in enumerate(columns):
        if column.hypothesis is not None:
            hypothesis = simulator.hypotheses[column.hypothesis]
            known.setdefault(hypothesis.name, (k, hypothesis.parameters[column.at].typical))
        elif (name := simulator.uncertain[column.at].like) in known:
            alike[k] = known[name]
        else:
            known[name] = k, 1.0
    return alike


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """One column of the sensitivities."""

    slope: Array
    """Change of the features per typical size, or per unit of a nuisance, (m,)."""
    bend: Array
    """Per square of that, (m,)."""
    reach: float
    """How far the simulator was asked, in typical sizes."""


def column_of(simulator: ArmSimulator, column: Column, nominal: Array) -> Sensed:
    """The parabola through three points, or a line where bounds leave one side or nothing bends.

    Steps are a few times what the campaign can see: one probe, of the motion that shows it most, tells. Much
    less would be lost in the rounding of counters, much more would be far from where it matters. Of repeats
    only the first is simulated: the others were given the same drive.
    """
    if column.hypothesis is None and (beside := simulator.uncertain[column.at].beside):
        simulator = simulator.patched(beside)
        nominal = simulator.predicted(())
    share = _share(simulator, column, nominal)
    ends = list(_ends(simulator, column, share))
    first = changed(simulator, ends[0].effects, nominal)
    for _ in range(TRIES):
        if _seen(simulator, first) <= TOO_MUCH * WANTED or column.hypothesis is None:
            break
        share *= WANTED / _seen(simulator, first)
        ends = list(_ends(simulator, column, share))
        first = changed(simulator, ends[0].effects, nominal)
    others = [changed(simulator, end.effects, nominal) for end in ends[1:]]
    slope, bend = through([(c, e.size) for c, e in zip((first, *others), ends, strict=True)])
    return Sensed(slope, bend, max(abs(end.size) for end in ends))


def _at(layout: Layout, place: str) -> Flags:
    """Features that are measured there, (m,)."""
    return np.array([layout.places[k] == place for k in layout.place], bool)


def _seen(simulator: ArmSimulator, change: Array) -> float:
    """Sigmas of all features together."""
    return float(np.linalg.norm(change / simulator.layout.sigma))


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """A state beside nominal."""

    effects: tuple[Effect, ...]
    size: float
    """Departure in typical sizes, or in units of the nuisance."""


def _share(simulator: ArmSimulator, column: Column, nominal: Array) -> float:
    """Of a typical size, the step: one that moves the features by WANTED sigmas in all."""
    if column.hypothesis is None:
        return 1.0
    end = next(iter(_ends(simulator, column, 1.0)))
    joints = {getattr(effect, "joint", None) for effect in end.effects} - {None}
    free = [one for one in simulator.campaign.moving if one.recording.world.surface is None]
    shown = [one for one in free if not {segment.joint for segment in one.segments} - joints]
    names = {one.recording.name for one in shown or free[-1:]}
    change = changed(simulator, end.effects, nominal, lambda one: one.recording.name in names)
    return float(np.clip(abs(end.size) * WANTED / max(_seen(simulator, change), 1e-12), LEAST_SHARE, 1.0))


def _ends(simulator: ArmSimulator, column: Column, share: float) -> Iterator[_End]:
    """On both sides of nominal where bounds allow it and it may bend."""
    zero = np.zeros(len(simulator.nuisances))
    for sign in (1.0, -1.0):
        if column.hypothesis is None:
            by, one = zero.copy(), simulator.uncertain[column.at]
            by[column.at] = 1.0 if one.one_sided else sign * one.nuisance.sigma
            if sign > 0.0 or not one.one_sided:
                yield _End(tuple(simulator.effects({}, by)), float(by[column.at]))
            continue
        hypothesis = simulator.hypotheses[column.hypothesis]
        parameter, values = hypothesis.parameters[column.at], hypothesis.absent
        absent = values[column.at]
        step = sign * share * parameter.typical
        values[column.at] = np.clip(absent + step, parameter.least, parameter.most)
        if values[column.at] == absent:
            continue
        effects = tuple(simulator.effects({hypothesis: values}, zero))
        yield _End(effects, float((values[column.at] - absent) / parameter.typical))
        if all(isinstance(effect, ONLY_POSED) for effect in effects):
            return  # geometry and springs are straight lines, as far as errors go


@cache
def _simulator(logs: Logs, kinds: Names) -> ArmSimulator:
    """Once in each process."""
    campaign = compared([recording_in(path) for path in logs])
    return arm_simulator(campaign, floor_of(campaign).sigma, {name: catalogue()[name] for name in kinds})


@cache
def _nominal(logs: Logs, kinds: Names) -> Array:
    return _simulator(logs, kinds).predicted(())


def _worked(job: _Job) -> tuple[int, Sensed]:
    simulator = _simulator(job.logs, job.kinds)
    column = columns_of(simulator)[job.column]
    return job.column, column_of(simulator, column, _nominal(job.logs, job.kinds))
