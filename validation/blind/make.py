"""Making of blind cases of this arm: the solver's campaign, the sealed truth, then the logs of every case."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from marsarm.common.pool import Runner
from marsarm.diagnosis.arm.blind_case import check_leakage, record_blind, sample_background
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.arm.simulator import catalogue_effect
from marsarm.diagnosis.blind_case import (
    PlannedCase,
    SealedTruth,
    TrueCase,
    TrueEffect,
    load_existing_truth,
    plan_cases,
    seal,
)
from marsarm.diagnosis.sampling import DetectableEffect, SampledEffect, list_detectable
from sim.arms import arm_named
from sim.diagnosis_campaign import DiagnosisSession, campaign_sessions
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.scenario.effects import effect_text
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress, no_progress, part_of
from validation.blind.arm_solver import load_model
from validation.blind.classes import CLASSES_FILE, classes_json
from validation.blind.folder import CAMPAIGN_FOLDER, CASES_FOLDER, PARTIAL_SUFFIX, case_name, write_json
from validation.blind.out_of_catalogue import list_samplable, list_uncatalogued, resolve_effect

CAMPAIGN_SHARES: Final = (0.01, 0.05)
"""Shares of the time of 400 cases, for the progress: the campaign is recorded; its limits are known."""


@dataclass(frozen=True, slots=True)
class MadeCases:
    """Result of `make`."""

    digest: str
    cases: int
    recorded: int
    """Number of cases that this call recorded."""
    left_out: tuple[str, ...]
    """Sessions whose motion did not complete; there is no log of them."""


@dataclass(frozen=True, slots=True)
class _Job:
    folder: Path
    case: TrueCase


def make_cases(
    folder: Path,
    cases: int,
    seed: int,
    run: Runner,
    progress: Progress,
    publish: Callable[[str], None] = lambda _: None,
) -> MadeCases:
    """Make blind cases from a seed; cases that exist stay.

    Args:
        folder: Folder of the cases.
        cases: Number of cases.
        seed: Seed of effects, arms and noise.
        run: Runner of parallel jobs.
        progress: Called with done, total and case.
        publish: Called with the digest of the truth before any case is recorded.

    Raises:
        BadRequest: The folder holds cases of another seed or number, or cannot be written.
        TruthLeaked: A log would reveal its truth; it is removed.
        BadOutput: A file cannot be written.
    """
    try:
        return _make_cases(folder, cases, seed, run, progress, publish)
    except OSError as error:
        raise BadRequest(f"out {folder}: cannot be written ({error.strerror or error})") from error


def _make_cases(
    folder: Path, cases: int, seed: int, run: Runner, progress: Progress, publish: Callable[[str], None]
) -> MadeCases:
    folder.mkdir(exist_ok=True)
    truth = load_existing_truth(folder, salt(seed), cases)
    if truth is None:
        outside = list_samplable()
        _record_campaign(folder, seed, part_of(progress, 0.0, CAMPAIGN_SHARES[0]))
        rest = part_of(progress, *CAMPAIGN_SHARES)
        catalogue = _list_detectable(folder / CAMPAIGN_FOLDER, run, rest)
        truth = draw_truth(cases, seed, catalogue, outside)
        seal(folder, truth)
    publish(truth.digest())
    jobs = [
        _Job(folder.absolute(), case)
        for case in truth.cases
        if not (folder / CASES_FOLDER / case.name).exists()
    ]
    of_cases = part_of(progress, CAMPAIGN_SHARES[1], 1.0)
    for done, name in enumerate(run(_record_job, jobs), 1):
        of_cases(done, len(jobs), name)
    return MadeCases(truth.digest(), cases, len(jobs), tuple(left_out(folder, truth, all_sessions())))


def left_out(folder: Path, truth: SealedTruth, wanted: Sequence[DiagnosisSession]) -> Iterator[str]:
    """Yield the sessions without a log."""
    for case in truth.cases:
        for session in wanted:
            if not (folder / CASES_FOLDER / case.name / f"{session.name}.mcap").exists():
                yield f"{case.name}/{session.name}"


def draw_truth(
    cases: int, seed: int, catalogue: Sequence[DetectableEffect], outside: Sequence[DetectableEffect]
) -> SealedTruth:
    """Draw the truth; the same seed and detection limits give the same truth."""
    plan = plan_cases(cases, catalogue, outside, np.random.default_rng([seed, 8]))
    return SealedTruth(salt(seed), tuple(_true_case(number, case, seed) for number, case in enumerate(plan)))


def salt(seed: int) -> str:
    """Return the salt of a seed; only who knows the seed can compute it."""
    return np.random.default_rng([seed, 9]).bytes(16).hex()


def _record_campaign(folder: Path, seed: int, progress: Progress) -> None:
    """Record the nominal arm: all that the solver knows about the campaign before the cases."""
    if not (folder / CAMPAIGN_FOLDER).exists():
        part = folder / (CAMPAIGN_FOLDER + PARTIAL_SUFFIX)
        shutil.rmtree(part, ignore_errors=True)
        arm = arm_named("nominal")
        number = int(np.random.default_rng([seed, 7]).integers(2**31))
        record_campaign(part, all_sessions(), arm, true_reference(arm), number, progress)
        part.rename(folder / CAMPAIGN_FOLDER)


def _list_detectable(campaign: Path, run: Runner, progress: Progress) -> list[DetectableEffect]:
    """List the effects of the catalogue with their detection limits by the fitted motions."""
    model = load_model(campaign, run, progress).model
    write_json(campaign / CLASSES_FILE, classes_json(model))
    limits = [one.limit for one in model.limits]
    return list_detectable(model.sensitivities.hypotheses, limits, model.label)


def _true_case(number: int, plan: PlannedCase, seed: int) -> TrueCase:
    rng = np.random.default_rng([seed, 10, number])
    specs = tuple(effect_text(effect) for effect in sample_background(rng))
    effects = tuple(_true_effect(one, plan.kind == "out-of-catalogue") for one in plan.effects)
    return TrueCase(case_name(number), plan.kind, effects, specs, int(rng.integers(10**9, 2**31)))


def _true_effect(one: SampledEffect, outside: bool) -> TrueEffect:
    hypothesis = one.source.hypothesis
    name = hypothesis.effect, hypothesis.place
    if outside:
        spec = list_uncatalogued()[name].spec(one.values)
    else:
        spec = effect_text(catalogue_effect(hypothesis, one.values))
    values = {p.name: float(v) for p, v in zip(hypothesis.parameters, one.values, strict=True)}
    return TrueEffect(*name, values, one.times_limit, spec)


def _record_job(job: _Job) -> str:
    """Record one case completely or not at all; return its name."""
    place = job.folder / CASES_FOLDER / job.case.name
    if place.exists():  # a worker recorded it and died before it could say so
        return job.case.name
    part = place.with_name(f".{place.name}{PARTIAL_SUFFIX}")
    shutil.rmtree(part, ignore_errors=True)
    try:
        record_case(part, job.case, all_sessions())
        for log in sorted(part.glob("*.mcap")):
            check_leakage(log, job.case)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    part.rename(place)
    return job.case.name


def record_case(folder: Path, case: TrueCase, wanted: Sequence[DiagnosisSession]) -> None:
    """Record the sessions of a case; a session whose motion does not complete gets no log."""
    record_blind(folder, true_effects(case), wanted, case.seed, no_progress)


def true_effects(case: TrueCase) -> tuple[Effect, ...]:
    """Return all effects of the plant."""
    return tuple(resolve_effect(spec) for spec in (*case.background, *(one.spec for one in case.effects)))


@cache
def all_sessions() -> tuple[DiagnosisSession, ...]:
    """Return the sessions of the campaign, computed once in each process."""
    return campaign_sessions(arm_named("nominal").params)
