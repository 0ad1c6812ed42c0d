"""Makes blind cases of our arm: the solver's campaign, the sealed truth, then the logs of every case."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.pool import Runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.arm.blind.background import background
from ground.diagnosis.arm.blind.evidence import known, split
from ground.diagnosis.arm.blind.outside import all_outside, effect_in, limits, some_outside
from ground.diagnosis.arm.blind.sealed import blind_reference, check_sealed
from ground.diagnosis.arm.record import record_campaign
from ground.diagnosis.arm.simulator import raced, switched_on, told
from ground.diagnosis.blind.classes import FILE, published
from ground.diagnosis.blind.folder import CAMPAIGN, CASES, PART, case_name, write_json
from ground.diagnosis.blind.plan import Planned, planned
from ground.diagnosis.blind.truth import TrueCase, TrueEffect, Truth, seal, sealed_before
from ground.diagnosis.drawn import Drawn, Seen
from sim.arms import arm_named, effects_of_run
from sim.diagnosis_campaign import DiagnosisSession, SessionFailed, campaign_sessions
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.plant import PlantDiverged
from sim.scenario.effects import effect_text


@dataclass(frozen=True, slots=True)
class Made:
    """What there is now."""

    digest: str
    cases: int
    recorded: int
    """Of them, by this call."""
    left_out: tuple[str, ...]
    """Sessions of all cases whose motion did not come to its end: there is no log of them."""


@dataclass(frozen=True, slots=True)
class _Job:
    folder: Path
    case: TrueCase


def make(
    folder: Path,
    cases: int,
    seed: int,
    run: Runner,
    progress: Progress,
    publish: Callable[[str], None] = lambda _: None,
) -> Made:
    """So many cases from a seed; what is there already stays. `publish` is told the digest before any case.

    Raises:
        BadRequest: the folder holds cases of another seed or number, or cannot be written.
        TellsTruth: a log would give its truth away; it is not there.
        BadOutput: a file cannot be written.
    """
    try:
        return _made(folder, cases, seed, run, progress, publish)
    except OSError as error:
        raise BadRequest(f"out {folder}: cannot be written ({error.strerror or error})") from error


def _made(
    folder: Path, cases: int, seed: int, run: Runner, progress: Progress, publish: Callable[[str], None]
) -> Made:
    folder.mkdir(exist_ok=True)
    truth = sealed_before(folder, salt(seed), cases)
    if truth is None:
        _record_campaign(folder, seed, progress)
        truth = drawn_truth(cases, seed, *_seen(folder / CAMPAIGN, seed, run, progress))
        seal(folder, truth)
    publish(truth.digest())
    jobs = [_Job(folder, case) for case in truth.cases if not (folder / CASES / case.name).exists()]
    for done, name in enumerate(run(_record, jobs), 1):
        progress(done, len(jobs), name)
    return Made(truth.digest(), cases, len(jobs), tuple(left_out(folder, truth, all_sessions())))


def left_out(folder: Path, truth: Truth, wanted: Sequence[DiagnosisSession]) -> Iterator[str]:
    """Sessions of which there is no log."""
    for case in truth.cases:
        for session in wanted:
            if not (folder / CASES / case.name / f"{session.name}.mcap").exists():
                yield f"{case.name}/{session.name}"


def drawn_truth(cases: int, seed: int, catalogue: Sequence[Seen], outside: Sequence[Seen]) -> Truth:
    """The same for the same seed, and for a campaign that sees the same."""
    plan = planned(cases, catalogue, outside, np.random.default_rng([seed, 8]))
    return Truth(salt(seed), tuple(_true_case(number, case, seed) for number, case in enumerate(plan)))


def salt(seed: int) -> str:
    """Of a seed; it does not tell which."""
    return np.random.default_rng([seed, 9]).bytes(16).hex()


def _record_campaign(folder: Path, seed: int, progress: Progress) -> None:
    """The nominal arm's logs: what the solver knows of the campaign before there are cases."""
    if not (folder / CAMPAIGN).exists():
        part = folder / (CAMPAIGN + PART)
        shutil.rmtree(part, ignore_errors=True)
        arm = arm_named("nominal")
        number = int(np.random.default_rng([seed, 7]).integers(2**31))
        record_campaign(part, all_sessions(), arm, true_reference(arm), number, progress)
        part.rename(folder / CAMPAIGN)


def _seen(campaign: Path, seed: int, run: Runner, progress: Progress) -> tuple[list[Seen], list[Seen]]:
    """Every hypothesis and every effect outside, with limits by the motions that are not held out."""
    ready = known(campaign, run, progress).ready
    found = [one.limit for one in ready.limits]
    write_json(campaign / FILE, published(ready.found.hypotheses, ready.label, found))
    seen = zip(ready.found.hypotheses, found, ready.label, strict=True)
    wanted = some_outside(np.random.default_rng([seed, 11]))
    outside = limits(split(campaign)[0], ready.prepared, campaign, wanted, run, progress)
    return [Seen(one, limit, int(number)) for one, limit, number in seen], outside


def _true_case(number: int, plan: Planned, seed: int) -> TrueCase:
    rng = np.random.default_rng([seed, 10, number])
    specs = tuple(effect_text(effect) for effect in background(rng))
    effects = tuple(_true_effect(one, plan.kind == "outside") for one in plan.effects)
    return TrueCase(case_name(number), plan.kind, effects, specs, int(rng.integers(10**9, 2**31)))


def _true_effect(one: Drawn, outside: bool) -> TrueEffect:
    hypothesis = one.seen.hypothesis
    name = hypothesis.effect, hypothesis.place
    spec = all_outside()[name].spec(one.values) if outside else _spec(name, one.values)
    values = {p.name: float(v) for p, v in zip(hypothesis.parameters, one.values, strict=True)}
    return TrueEffect(*name, values, one.times_limit, spec)


def _spec(name: tuple[str, str], values: Array) -> str:
    made = next(one for one in raced(None) if (told(one).effect, told(one).place) == name)
    return effect_text(switched_on(made, told(made), values))


def _record(job: _Job) -> str:
    """One case, all of it or nothing; its name."""
    place = job.folder / CASES / job.case.name
    part = place.with_name(f".{place.name}{PART}")
    shutil.rmtree(part, ignore_errors=True)
    try:
        record_case(part, job.case, all_sessions())
        for log in sorted(part.glob("*.mcap")):
            check_sealed(log, job.case)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    part.rename(place)
    return job.case.name


def record_case(folder: Path, case: TrueCase, wanted: Sequence[DiagnosisSession]) -> None:
    """Logs of some sessions; one whose motion does not come to its end has none."""
    effects = true_effects(case)
    nominal = arm_named("nominal")
    arm = nominal.with_effects(effects)
    begun = effects_of_run(effects)
    reference = blind_reference(arm)
    seeds = np.random.default_rng(case.seed).integers(2**31, size=len(wanted))
    for session, seed in zip(wanted, seeds, strict=True):
        try:
            record_campaign(folder, [session], arm, reference, int(seed), lambda *_: None, begun)
        except (SessionFailed, PlantDiverged):
            (folder / f"{session.name}.mcap").unlink(missing_ok=True)


def true_effects(case: TrueCase) -> tuple[Effect, ...]:
    """All that its plant is made of."""
    return tuple(effect_in(spec) for spec in (*case.background, *(one.spec for one in case.effects)))


@cache
def all_sessions() -> tuple[DiagnosisSession, ...]:
    """Of the campaign, once in each process."""
    return campaign_sessions(arm_named("nominal").params)
