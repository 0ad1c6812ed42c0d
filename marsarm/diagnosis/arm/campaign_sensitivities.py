"""Sensitivities of a campaign: parallel finite differences of the arm's simulator, cached in files.

`compute_sensitivities` is the entry. It adapts the step of every column to the noise, in the rests and in the
motions that move most joints at once: there both sides are simulated too. The other motions, which take most
of the time, are simulated on the other side only for columns whose curvature is visible. A parabola goes
through the steps (`finite_differences`). The name of the cache file holds a digest of logs, model,
parameters, catalogue and code.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from fsw.dictionary.params import digest
from fsw.kinematics.transforms import Array
from marsarm.common.pool import Runner, digest_sources, in_order
from marsarm.common.requests import NOMINAL_ARM
from marsarm.diagnosis.arm import finite_differences as differences
from marsarm.diagnosis.arm.arm_effects import list_hypotheses, list_nuisances, moves
from marsarm.diagnosis.arm.audit import load_checked_recordings
from marsarm.diagnosis.arm.case_simulator import MIN_CURVED
from marsarm.diagnosis.arm.feature_set import FeatureSet, build_feature_set, lay_out, simulate_features
from marsarm.diagnosis.arm.rest_poses import STEP_NUMERICS, is_stepped
from marsarm.diagnosis.model import form_normal_equations
from marsarm.diagnosis.problem import (
    FeatureLayout,
    Hypothesis,
    Ints,
    Nuisance,
    Sensitivities,
    fit_parabola,
    load_sensitivities,
    save_sensitivities,
)
from marsarm.telemetry.recorder import model_digest
from sim.arms import arm_named
from sim.effects.catalogue import catalogue
from sim.setting import World
from sim.world import build
from simgap.common.errors import BadRequest
from simgap.common.files import file_sha256
from simgap.common.progress import Progress, as_guess, part_of

Logs = tuple[Path, ...]
Names = tuple[str, ...]
DECIDING: Final = ("fsw", "sim", "marsarm.diagnosis", "simgap.serial_arm")
"""Packages that decide the result."""
NUMERICS_SHARE: Final = 0.25
"""Share of a numerical error that remains after the fit, in the motions of the campaign: with three implicit
steps a cycle 0.09, with nine explicit ones 0.23, with seven 0.27."""


@dataclass(frozen=True, slots=True)
class _Campaign:
    logs: Logs
    kinds: Names
    arm: str
    """Name of an arm of its drawing."""


@cache
def _list_known(campaign: _Campaign) -> tuple[tuple[Hypothesis, ...], tuple[Nuisance, ...]]:
    """List hypotheses and nuisances; once a process."""
    arm = arm_named(campaign.arm).model
    return tuple(list_hypotheses(campaign.kinds, arm.params.tool_names)), tuple(list_nuisances(arm))


@cache
def _list_columns(campaign: _Campaign) -> list[differences.Column]:
    return differences.list_columns(*_list_known(campaign))


def compute_sensitivities(
    logs: Sequence[Path],
    kept_in: Path,
    run: Runner,
    progress: Progress,
    kinds: Sequence[str] | None = None,
    steps_of: Sequence[Path] = (),
    arm: str = NOMINAL_ARM,
) -> Sensitivities:
    """Compute the sensitivities of a campaign, or load them from the cache.

    Kinds are names of effects; None stands for all. Steps are those of the cached logs `steps_of`, or adapted
    without these. NotForDiagnosis if a log cannot be compared, BadRequest or BadOutput if a cached file
    or its folder cannot be read or written.
    """
    # absolute, as a worker may be in another folder
    paths, others = (tuple(path.absolute() for path in sorted(some)) for some in (logs, steps_of))
    names = tuple(catalogue() if kinds is None else kinds)
    path = kept_in / _cache_name(arm, names, paths, others)
    campaign = _Campaign(paths, names, arm)
    known = _list_known(campaign)
    if path.exists():
        return load_sensitivities(path, *known)
    check_cache_folder(kept_in)
    steps = load_sensitivities(kept_in / _cache_name(arm, names, others), *known).reach if others else None
    found = _difference_all(campaign, run, as_guess(progress), steps)
    save_sensitivities(path, found)
    return found


def _cache_name(arm: str, kinds: Names, *logs: Logs) -> str:
    digests = [campaign_digest(some, kinds, arm)[:16] for some in logs if some]
    return f"sensitivities-{'-'.join(digests)}.npz"


def _difference_all(
    campaign: _Campaign, run: Runner, progress: Progress, given: Array | None
) -> Sensitivities:
    """Simulate the columns with given steps of hypotheses, (k,), or with adapted ones, and fit parabolas."""
    columns = _list_columns(campaign)
    borrowed = differences.find_borrowed_slopes(columns)
    shares = {
        k: 1.0 for k, one in enumerate(columns) if k not in borrowed or isinstance(one.source, Hypothesis)
    }
    both = [k for k in shares if len(columns[k].sides(1.0)) > 1]
    work = [_count_ticks(campaign, *one) for one in ((shares, True), (both, True), (shares, False))]
    work[0] *= 2 if given is None else 1  # each round of steps is taken to have half the work of the last
    ends = np.cumsum([0, *work]) / sum(work)
    steps, sides, rest = (part_of(progress, *span) for span in pairwise(ends.tolist()))
    if given is None:
        up = _choose_steps(campaign, run, steps, shares)
    else:
        up = _simulate(campaign, shares | dict(enumerate(given.tolist())), 0, True, run, steps)
    shares = {k: one.share for k, one in up.items()}
    two_sided = {k: by for k, by in shares.items() if len(columns[k].sides(by)) > 1}
    down = _simulate(campaign, two_sided, 1, True, run, sides)
    (_, first, rows), (_, _, other_rows) = (_part(campaign, is_first) for is_first in (True, False))
    slope, curvature, reach = _fit_parabolas(campaign, up, down)
    if other_rows.size:
        # a line misses a step by MIN_CURVED noise floors
        missed = np.abs(curvature * reach**2) > MIN_CURVED * first.sigma[:, None]
        curved = {k: two_sided[k] for k in down if missed[:, k].any()}
        done = work[-1] / (work[-1] + _count_ticks(campaign, curved, False))
        up = _simulate(campaign, shares, 0, False, run, part_of(rest, 0.0, done))
        down = _simulate(campaign, curved, 1, False, run, part_of(rest, done, 1.0))
        other_slope, other_curvature, _ = _fit_parabolas(campaign, up, down)
        order = np.argsort(np.concatenate([rows, other_rows]))
        slope = np.concatenate([slope, other_slope])[order]
        curvature = np.concatenate([curvature, other_curvature])[order]
    return _assemble(campaign, *_lay_out(campaign), slope, curvature, reach)


def _simulate(
    campaign: _Campaign,
    shares: Mapping[int, float],
    side: int,
    is_first: bool,
    run: Runner,
    progress: Progress,
) -> dict[int, differences.OneSidedStep]:
    """Simulate one side of columns with these steps in a part of the features."""
    at_once = differences.group_columns(_list_columns(campaign), sorted(shares))
    nominal = _nominal_features(campaign, is_first)
    jobs = [(campaign, is_first, nominal, side, {k: shares[k] for k in of}) for of in at_once]
    steps: dict[int, differences.OneSidedStep] = {}
    done, total = 0, _count_ticks(campaign, shares, is_first)
    for found in in_order(run, _simulate_at_once, jobs):
        steps |= found
        done += _count_ticks(campaign, found, is_first)
        progress(done, total, "sensitivities")
    return steps


def _count_ticks(campaign: _Campaign, wanted: Iterable[int], is_first: bool) -> int:
    """Count the cycles that one side of columns simulates, which take the time, and one for each job."""
    columns, (feature_set, *_) = _list_columns(campaign), _part(campaign, is_first)
    rests = sum(1 + max(one.turning_points.tick, default=0) for one in feature_set.rests)
    ticks = 0
    for of in differences.group_columns(columns, sorted(wanted)):
        effects = [columns[k].sides(1.0)[0][0] for k in of]
        moved = [one for one in feature_set.motions if any(moves(effect, one) for effect in effects)]
        ticks += 1 + sum({one.recording.block: one.compared_ticks for one in moved}.values())
        ticks += rests * any(map(is_stepped, effects))
    return ticks


def _choose_steps(
    campaign: _Campaign, run: Runner, progress: Progress, first: Mapping[int, float]
) -> dict[int, differences.OneSidedStep]:
    """Adapt the steps to the noise: in the rests, and in the motions that move most joints at once.

    A column with its slope from a nuisance keeps its step: another step would not change that slope.
    Numerical errors keep theirs too. They are simulated last, as their rests take long. A step has the share
    of the typical size of its column.
    """
    columns, (feature_set, layout, _) = _list_columns(campaign), _part(campaign, True)
    fixed = differences.find_borrowed_slopes(columns)
    last: dict[int, differences.OneSidedStep] = {}
    numerical = [k for k in first if isinstance(one := columns[k].source, Nuisance) and one.only_channel]
    wanted = {k: by for k, by in first.items() if k not in numerical}
    chosen, best = last, dict.fromkeys(first, math.inf)
    late = 0.5 * _count_ticks(campaign, numerical, True) / _count_ticks(campaign, first, True)
    rounds = part_of(progress, 0.0, 1.0 - late)
    for attempt in range(differences.MAX_ROUNDS + 1):
        update = part_of(rounds, 1.0 - 0.5**attempt, 1.0 - 0.5 ** (attempt + 1))
        last = last | _simulate(campaign, wanted, 0, True, run, update)
        found = _assemble(campaign, feature_set, layout, *_fit_parabolas(campaign, last, {}))
        scale = form_normal_equations(found).scale
        seen = {k: float(by) * abs(last[k].size) for k, by in enumerate(scale) if k not in fixed}
        nearer = [k for k in seen if differences.step_error(seen[k]) < best[k]]
        chosen = last | chosen | {k: last[k] for k in nearer}
        best |= {k: differences.step_error(seen[k]) for k in nearer}
        better = {k: differences.adapt_step(last[k].share, by) for k, by in seen.items()}
        wanted = {k: by for k, by in better.items() if by and columns[k].sides(by)[0][1] != last[k].size}
        if not wanted:
            break
    left = {k: by for k, by in first.items() if k not in chosen}
    return chosen | _simulate(campaign, left, 0, True, run, part_of(progress, 1.0 - late, 1.0))


def _fit_parabolas(
    campaign: _Campaign,
    up: Mapping[int, differences.OneSidedStep],
    down: Mapping[int, differences.OneSidedStep],
) -> tuple[Array, Array, Array]:
    """Fit slopes and curvatures through simulated steps, (m, n) for n columns; return the largest steps too.

    Where there is one side, it is a line. A hypothesis that is also a nuisance takes its slope from the
    nuisance, and only its curvature from its own steps.
    """
    columns = _list_columns(campaign)
    slope, curvature = np.zeros((2, next(iter(up.values())).change.size, len(columns)))
    reach = np.ones(len(columns))
    for k, side in up.items():
        sides = [side, down[k]] if k in down else [side]
        slope[:, k], curvature[:, k] = fit_parabola([(one.change, one.size) for one in sides])
        reach[k] = max(abs(one.size) for one in sides)
    for k, (other, factor) in differences.find_borrowed_slopes(columns).items():
        slope[:, k] = slope[:, other] * factor
    return slope, curvature, reach


def _assemble(
    campaign: _Campaign,
    feature_set: FeatureSet,
    layout: FeatureLayout,
    slope: Array,
    curvature: Array,
    reach: Array,
) -> Sensitivities:
    """Make sensitivities of slopes and curvatures, (m, n), and largest steps, (n,), of n columns.

    Numerical errors are restricted to their channel. Rests are simulated with STEP_NUMERICS only; other
    numerics share their change.
    """
    hypotheses, nuisances = known = _list_known(campaign)
    owner = np.array([k for k, one in enumerate(hypotheses) for _ in one.parameters], np.intp)
    sized, rests = owner.size, slice(feature_set.n_moving, None)
    nuisance = slope[:, sized:].copy()
    numerical = [k for k, one in enumerate(nuisances) if one.only_channel]
    stepped = next(k for k in numerical if differences.Column(nuisances[k]).sides(1.0)[0][0] == STEP_NUMERICS)
    for k in numerical:
        nuisance[rests, k] = slope[rests, sized + stepped]
        nuisance[layout.channel != nuisances[k].only_channel, k] = 0.0
    own = nuisance[:, [bool(one.only_channel) for one in nuisances]]
    # a share of the numerical errors is noise: the fit removes them only in part
    sigma = np.sqrt(layout.sigma**2 + np.sum((NUMERICS_SHARE * own) ** 2, axis=1))
    layout, derivatives = replace(layout, sigma=sigma), (slope[:, :sized], curvature[:, :sized])
    return Sensitivities(layout, *known, *derivatives, reach[:sized], owner, nuisance)


def check_cache_folder(kept_in: Path) -> None:
    """Make the folder of a cache; BadRequest if it cannot be made."""
    try:
        kept_in.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadRequest(f"{kept_in}: no sensitivities can be kept there ({error.strerror})") from error


def campaign_digest(logs: Logs, kinds: Names, arm: str) -> str:
    """Return the SHA-256 of all inputs of the sensitivities: logs, drawing of the arm, model and code."""
    drawing = arm_named(arm).model
    parts = [digest_sources(DECIDING), *kinds, digest(drawing.params)]
    parts.append(model_digest(build(World(), drawing).compile()))
    parts += digest_logs(logs)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def digest_logs(logs: Logs) -> list[str]:
    """Return the SHA-256 of each log, then of each table of tracker poses beside them."""
    trackers = (path.with_suffix(".tracker.csv") for path in logs)
    return [file_sha256(path) for path in (*logs, *(one for one in trackers if one.exists()))]


@cache
def _lay_out(campaign: _Campaign) -> tuple[FeatureSet, FeatureLayout]:
    """Return the features and their layout; once in each process."""
    recordings = load_checked_recordings(campaign.logs, arm=arm_named(campaign.arm).model)
    feature_set = build_feature_set(recordings)
    return feature_set, lay_out(feature_set)[0]


@cache
def _part(campaign: _Campaign, is_first: bool) -> tuple[FeatureSet, FeatureLayout, Ints]:
    """Return a part of the features, its layout, and its rows among all features; once a process.

    The first part are rests, touches, and the motions that move as many joints as any, away from a surface.
    """
    every, layout = _lay_out(campaign)
    joints = [
        len({segment.joint for segment in one.segments}) if one.recording.world.surface is None else 0
        for one in every.motions
    ]
    pairs = zip(every.motions, joints, strict=True)
    motions = tuple(one for one, count in pairs if (count == max(joints)) is is_first)
    still = (every.rests, every.touches, every.presses) if is_first else ((), (), ())
    feature_set = FeatureSet(motions, *still)
    own = set(feature_set.list_features())
    rows = np.flatnonzero([one in own for one in every.list_features()])
    return feature_set, layout.select(rows), rows


@cache
def _nominal_features(campaign: _Campaign, is_first: bool) -> Array:
    return simulate_features(_part(campaign, is_first)[0], ())


def _simulate_at_once(
    campaign: _Campaign, is_first: bool, nominal: Array, side: int, shares: Mapping[int, float]
) -> dict[int, differences.OneSidedStep]:
    """Simulate one side of some columns, which have these steps, at once."""
    feature_set, *_ = _part(campaign, is_first)
    return differences.simulate_side(feature_set, _list_columns(campaign), nominal, side, shares)
