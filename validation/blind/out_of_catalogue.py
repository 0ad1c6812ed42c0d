"""Out-of-catalogue effects from a folder of Python files, and their detection limits.

The limits come from open-loop simulation with and without each effect (`change`), with adaptive steps.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from diagnosis.serial_arm.screws import screw_log
from fsw.kinematics.transforms import Array, inverse, stack_poses
from ground.common.checkpoint import Checkpoint
from ground.common.errors import BadRequest
from ground.common.pool import Runner
from ground.common.progress import Progress
from ground.diagnosis.arm.audit import load_checked_recordings
from ground.diagnosis.arm.feature_set import FeatureSet, RestFeatures, build_feature_set
from ground.diagnosis.arm.features import MotionFeatures, evaluate_features
from ground.diagnosis.arm.finite_differences import MAX_ROUNDS, adapt_step, step_error
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.open_loop import (
    OpenLoopRun,
    simulate_open_loop,
    simulate_open_loop_cached,
    stack_readings,
)
from ground.diagnosis.arm.rest_poses import read_resolvers
from ground.diagnosis.arm.simulator import SHORT_SETTLING, make_effect, to_hypothesis
from ground.diagnosis.detectability import column_detection_limit, noncentrality
from ground.diagnosis.normal_equations import NormalEquations
from ground.diagnosis.problem import Hypothesis
from ground.diagnosis.result import finite_or_none
from ground.diagnosis.sampling import DetectableEffect
from sim.effects import catalogue
from sim.effects.effect import Effect
from sim.open_loop import SimulationOptions
from sim.params import nominal_params
from sim.scenario.effects import BadEffect, effect_classes_in_file, effect_text, parse_effect_text

PLACES_PER_EFFECT: Final = 2
"""Number of places of each effect that are used: limits of all would take as long as the cases."""


def change(feature_set: FeatureSet, effects: Sequence[Effect], options: SimulationOptions) -> Array:
    """Compute the change of the features by effects.

    Args:
        feature_set: Features of all recordings.
        effects: Effects that are switched on.
        options: Simulation options.

    Returns:
        Change in the units of the channels, shape (m,).
    """
    return np.concatenate(
        [_motion_change(one, effects, options) for one in feature_set.motions]
        + [_rest_change(one, effects, options) for one in feature_set.rests]
    )


def _motion_change(one: MotionFeatures, effects: Sequence[Effect], options: SimulationOptions) -> Array:
    with_it, without = _with_and_without(one.recording, effects, options)
    return evaluate_features(one, stack_readings(with_it.readings)) - evaluate_features(
        one, stack_readings(without.readings)
    )


def _rest_change(one: RestFeatures, effects: Sequence[Effect], options: SimulationOptions) -> Array:
    recording = one.turning_points.recording
    ends = [one.turning_points.tick[one.turning_points.rests[r]] + 1 for r, _ in one.tracked_rests]
    with_it, without = _with_and_without(recording, effects, options, frozenset(ends))
    resolvers = _resolver_angles(one, with_it) - _resolver_angles(one, without)
    if not ends:
        return np.asarray(resolvers.ravel())
    before, after = (stack_poses([found.X_RF[end] for end in ends]) for found in (without, with_it))
    return np.concatenate([resolvers.ravel(), screw_log(inverse(before) @ after).ravel()])


def _with_and_without(
    recording: Recording,
    effects: Sequence[Effect],
    options: SimulationOptions,
    pose_ticks: frozenset[int] = frozenset(),
) -> tuple[OpenLoopRun, OpenLoopRun]:
    """Simulate with effects, and without; the run without is cached for the next effect."""
    return simulate_open_loop(recording, effects, options, pose_ticks), simulate_open_loop_cached(
        recording, (), options, pose_ticks
    )


def _resolver_angles(one: RestFeatures, found: OpenLoopRun) -> Array:
    """Return resolvers minus motor angles at the rests, (5, r)."""
    recording = replace(one.turning_points.recording, sensors=stack_readings(found.readings))
    return read_resolvers(replace(one.turning_points, recording=recording))


EFFECTS_FOLDER: Final = Path(__file__).resolve().parents[2] / "validation" / "out_of_catalogue_effects"


@dataclass(frozen=True, slots=True, eq=False)
class UncataloguedEffect:
    """Out-of-catalogue effect at a place."""

    hypothesis: Hypothesis
    catalogue_entry: catalogue.EffectHypothesis

    def spec(self, values: Array) -> str:
        """Return the text that switches the effect on, with the name of its file in the folder."""
        text = effect_text(make_effect(self.catalogue_entry, self.hypothesis, values))
        return text.removeprefix(f"{EFFECTS_FOLDER}/")


@dataclass(frozen=True, slots=True)
class _Job:
    logs: tuple[Path, ...]
    name: tuple[str, str]
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class _Sensitivity:
    name: tuple[str, str]
    share: float
    """Step as a share of a typical size."""
    column: Array
    """Change of the features per typical size, upwards, shape (m,)."""


def _effect_files() -> list[Path]:
    return sorted(EFFECTS_FOLDER.glob("*/*.py"))


def list_uncatalogued() -> dict[tuple[str, str], UncataloguedEffect]:
    """List all out-of-catalogue effects by effect and place; BadRequest if there are no files."""
    files = _effect_files()
    if not files:
        raise BadRequest(f"{EFFECTS_FOLDER}: holds no effects; cases are made in a clone of the repository")
    kinds = {kind.__name__: kind for file in files for kind in effect_classes_in_file(str(file))}
    found = (UncataloguedEffect(to_hypothesis(made), made) for made in catalogue.hypotheses(kinds))
    return {(one.hypothesis.effect, one.hypothesis.place): one for one in found}


def resolve_effect(spec: str) -> Effect:
    """Return the effect of a text, in the catalogue or in the folder."""
    try:
        text = str(EFFECTS_FOLDER / spec) if ".py:" in spec else spec
        return parse_effect_text(text, nominal_params().tool_names)
    except BadEffect as error:
        raise BadRequest(str(error)) from error


def sample_uncatalogued(rng: np.random.Generator) -> dict[tuple[str, str], UncataloguedEffect]:
    """Sample a few places of each effect."""
    known = list_uncatalogued()
    kinds = sorted({name for name, _ in known})
    found: dict[tuple[str, str], UncataloguedEffect] = {}
    for kind in kinds:
        places = sorted(place for name, place in known if name == kind)
        chosen = rng.choice(len(places), min(PLACES_PER_EFFECT, len(places)), replace=False)
        found |= {(kind, places[k]): known[kind, places[k]] for k in chosen}
    return found


def uncatalogued_limits(
    logs: Sequence[Path],
    equations: NormalEquations,
    kept_in: Path,
    wanted: Mapping[tuple[str, str], UncataloguedEffect],
    run: Runner,
    progress: Progress,
) -> list[DetectableEffect]:
    """Compute the detection limit of each effect beside the nuisances; finished ones are cached.

    Args:
        logs: Logs of the campaign.
        equations: Normal equations of the campaign.
        kept_in: Cache folder.
        wanted: Effects by name and place.
        run: Runner of parallel jobs.
        progress: Called with done, total and step.

    Raises:
        BadRequest: The cache belongs to another campaign or other effects.
    """
    with Checkpoint(
        kept_in / "out_of_catalogue.jsonl", {"of": _inputs_digest(logs, equations)}, _read_limit
    ) as kept:
        limits = {(one["name"], one["place"]): _read_limit(one) for one in kept.done}
        shares = {name: 1.0 for name in wanted if name not in limits}
        best = dict.fromkeys(shares, np.inf)
        for attempt in range(MAX_ROUNDS + 1):
            jobs = [
                _Job(tuple(log.absolute() for log in logs), name, share) for name, share in shares.items()
            ]
            shares = {}
            for done, one in enumerate(run(_difference, jobs), 1):
                limit = column_detection_limit(equations, one.column[:, None])
                seen = one.share * float(np.sqrt(noncentrality(1))) / limit
                if step_error(seen) < best[one.name] or one.name not in limits:
                    limits[one.name], best[one.name] = limit, step_error(seen)
                better = adapt_step(one.share, seen)
                if better is not None and attempt < MAX_ROUNDS:
                    shares[one.name] = better
                else:
                    kept.add(
                        {"name": one.name[0], "place": one.name[1], "limit": finite_or_none(limits[one.name])}
                    )
                progress(done, len(jobs), "out-of-catalogue")
    return [DetectableEffect(one.hypothesis, limits[name], None) for name, one in wanted.items()]


def _read_limit(entry: dict[str, Any]) -> float:
    return float("inf") if entry["limit"] is None else float(entry["limit"])


def _difference(job: _Job) -> _Sensitivity:
    return _Sensitivity(
        job.name, job.share, _simulate_step(_feature_set(job.logs), job.name, job.share) / job.share
    )


def _simulate_step(feature_set: FeatureSet, name: tuple[str, str], share: float) -> Array:
    """Simulate a share of the typical size; return the change of the features, (m,)."""
    one = list_uncatalogued()[name]
    values = np.array([p.absent + share * p.typical * p.is_amplitude for p in one.hypothesis.parameters])
    effect = make_effect(one.catalogue_entry, one.hypothesis, values)
    return change(feature_set, (effect,), SHORT_SETTLING)


@cache
def _feature_set(logs: tuple[Path, ...]) -> FeatureSet:
    return build_feature_set(load_checked_recordings(logs))


def _inputs_digest(logs: Sequence[Path], equations: NormalEquations) -> str:
    """Return the SHA-256 of the logs, the nuisances and the effect files."""
    total = hashlib.sha256(equations.A[:, : equations.q].tobytes() + equations.whiten.sigma.tobytes())
    for path in (*sorted(logs), *_effect_files()):
        total.update(path.read_bytes())
    return total.hexdigest()
