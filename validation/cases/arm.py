"""Blind cases of this arm: the solver's campaign, sealed truth, logs of every case, and their diagnosis."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from pydantic import TypeAdapter

from marsarm.common.pool import Runner, in_order, local_runner
from marsarm.common.rates import rate_of
from marsarm.common.requests import NOMINAL_ARM
from marsarm.diagnosis.arm import demo
from marsarm.diagnosis.arm.case import CampaignModel, load_campaign_model
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.arm.record import record_campaign, split_logs
from sim.arms import arm_named
from sim.diagnosis_campaign import DiagnosisSession, campaign_sessions
from sim.initialisation import true_reference
from sim.plant import PlantDiverged
from sim.scenario.effects import effect_text
from simgap import to_document
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress, no_progress
from simgap.common.report import to_json
from validation.campaigns import Context, Document
from validation.cases import sealed
from validation.cases.arm_score import CLASSES_FILE, EquivalenceClasses, classes_json, load_classes, score
from validation.cases.arm_truth import (
    EFFECTS_FOLDER,
    PlannedCase,
    SealedEffect,
    TrueCase,
    check_leakage,
    list_uncatalogued,
    load_outside_effects,
    plan_cases,
    resolve_effect,
)
from validation.cases.sealed import CaseScore, SealedTruth

CAMPAIGN_FOLDER: Final = "campaign"
DIAGNOSIS_SEED: Final = 1
"""Seed of the diagnosis, independent of the seed of the cases."""
SMALL_SESSIONS: Final = ("poses-rolled-1", "poses-level-5")
"""Sessions of a small run; the last one is held out. At rest only: motions take hours."""
SMALL_KINDS: Final = ("resolver-bias",)


NO_DIAGNOSIS: Final = (NotForDiagnosis, PlantDiverged)
"""Errors of a case that cannot be diagnosed; their message says why."""


@dataclass(frozen=True, slots=True)
class ArmCases(sealed.CaseMaker[TrueCase]):
    """Cases of this arm."""

    sessions: tuple[str, ...] | None = None
    """Names of the sessions of the campaign; None for all."""
    kinds: tuple[str, ...] | None = None
    """Effects of the catalogue; None for all, and effects outside the catalogue too."""
    arm: str = NOMINAL_ARM
    """Name of an arm of its drawing."""

    name: ClassVar[str] = "arm-cases"
    suffix: ClassVar[str] = ""
    truth_type: ClassVar[TypeAdapter[SealedTruth[TrueCase]]] = TypeAdapter(SealedTruth[TrueCase])

    def draw(
        self, folder: Path, cases: int, seed: int, run: Runner, progress: Progress
    ) -> tuple[TrueCase, ...]:
        """Record the nominal arm, publish its classes, and draw effects by their detection limits."""
        campaign = folder / CAMPAIGN_FOLDER
        if not campaign.exists():
            part = folder / (CAMPAIGN_FOLDER + sealed.PARTIAL_SUFFIX)
            shutil.rmtree(part, ignore_errors=True)
            arm, number = arm_named(self.arm), int(np.random.default_rng([seed, 7]).integers(2**31))
            sessions = choose_sessions(self.sessions, self.arm)
            record_campaign(part, sessions, arm, true_reference(arm), number, progress)
            part.rename(campaign)
        model = load_model(campaign, self.kinds, self.arm, run, progress).model
        sealed.write_json(campaign / CLASSES_FILE, classes_json(model))
        known = demo.list_detectable(model, model.limits)
        # The typical size stands for the limit, which takes a minute of CPU for each effect and place.
        every = list_uncatalogued().values()
        outside = [demo.DetectableEffect(one, 1.0, None) for one in every]
        return draw_truth(cases, seed, known, outside if self.kinds is None else [], self.arm)

    def record(self, path: Path, case: TrueCase) -> None:
        """Record the sessions of a case; a session whose motion does not complete gets no log."""
        specs = (*case.background, *(one.spec for one in case.effects))
        tools = arm_named(self.arm).params.tool_names
        effects = tuple(resolve_effect(spec, tools) for spec in specs)
        sessions = choose_sessions(self.sessions, self.arm)
        demo.record_blind(path, effects, sessions, case.seed, no_progress, self.arm)
        for log in sorted(path.rglob("*.mcap")):
            check_leakage(log, case, self.arm)

    def prepare(self, folder: Path, run: Runner, progress: Progress) -> None:
        load_model(folder / CAMPAIGN_FOLDER, self.kinds, self.arm, run, progress)

    def load(self, folder: Path) -> None:
        load_cached_model(folder / CAMPAIGN_FOLDER, self.kinds, self.arm)

    def diagnose(self, folder: Path, case: Path, without: str = "") -> Document:
        """Diagnose a case, with a catalogue that lacks one effect if named."""
        campaign = load_cached_model(folder / CAMPAIGN_FOLDER, self.kinds, self.arm)
        found = demo.diagnose_blind(case, campaign, DIAGNOSIS_SEED, without, self.arm)
        return to_document(found.diagnosis)

    def solve(self, folder: Path, case: Path) -> Document:
        """Diagnose a case; "unknown" without effects if it cannot be diagnosed."""
        try:
            return self.diagnose(folder, case)
        except NO_DIAGNOSIS as why:
            return {"verdict": "unknown", "refused": str(why), "findings": []}

    def score(self, folder: Path, solved: Sequence[tuple[TrueCase, Document]]) -> CaseScore:
        """Score solved cases; a small run is in bounds if no name is wrong and the truth is in each set."""
        for case, result in solved:
            check_result(case, result)
        found = score(load_classes(folder / CAMPAIGN_FOLDER), solved)
        bars, spurious = found.document["bars"], found.document["named, but not of the case"]
        is_right = bars["set coverage"]["hits"] == bars["reported"]["of"]
        in_bounds = bars["false alarms"]["hits"] == spurious["hits"] == 0 and is_right
        return replace(found, in_bounds=in_bounds or self.kinds is None)


@cache
def choose_sessions(names: tuple[str, ...] | None, arm: str = NOMINAL_ARM) -> tuple[DiagnosisSession, ...]:
    """Return the sessions of these names, or all of the campaign of an arm."""
    every = campaign_sessions(arm_named(arm).params)
    return tuple(one for one in every if names is None or one.name in names)


def load_model(
    campaign: Path, kinds: tuple[str, ...] | None, arm: str, run: Runner, progress: Progress
) -> CampaignModel:
    """Load the campaign model; compute and cache what is missing; BadRequest without its logs."""
    fitted, held = split_logs(campaign)
    if not fitted or not held:
        raise BadRequest(f"{campaign}: lacks the campaign's logs; the step make records them")
    return load_campaign_model(fitted, held, campaign, run, progress, kinds, arm)


@cache
def load_cached_model(campaign: Path, kinds: tuple[str, ...] | None, arm: str) -> CampaignModel:
    """Load the campaign model once in each process."""
    return load_model(campaign, kinds, arm, local_runner(1), no_progress)


def draw_truth(
    cases: int,
    seed: int,
    known: Sequence[demo.DetectableEffect],
    outside: Sequence[demo.DetectableEffect],
    arm: str = NOMINAL_ARM,
) -> tuple[TrueCase, ...]:
    """Draw the truth; the same seed and detection limits give the same truth."""
    plan = plan_cases(cases, known, outside, np.random.default_rng([seed, 8]))
    return tuple(_true_case(number, case, seed, arm) for number, case in enumerate(plan))


def _true_case(number: int, plan: PlannedCase, seed: int, arm: str) -> TrueCase:
    rng = np.random.default_rng([seed, 10, number])
    specs = tuple(effect_text(effect) for effect in demo.sample_background(rng, arm))
    effects = tuple(map(_true_effect, plan.effects))
    return TrueCase(sealed.case_name(number), plan.kind, effects, specs, int(rng.integers(10**9, 2**31)))


def _true_effect(one: demo.SampledEffect) -> SealedEffect:
    hypothesis = one.source.hypothesis
    # without the folder, in which effects outside the catalogue are found again
    spec = effect_text(one.switch_on()).removeprefix(f"{EFFECTS_FOLDER}/")
    pairs = zip(hypothesis.parameters, hypothesis.values(one.departures).tolist(), strict=True)
    values = {parameter.name: value for parameter, value in pairs}
    return SealedEffect(hypothesis.name, hypothesis.place, values, one.times_limit, spec)


def check_result(case: TrueCase, result: Document) -> None:
    """Raise BadRequest if a case or its result is of another version."""
    for effect in case.effects if case.kind == "out-of-catalogue" else ():
        if effect.name not in load_outside_effects():
            raise BadRequest(
                f"{case.name}: {effect.name} is none of today's effects outside the catalogue; score it with "
                f"the marsarm that made it"
            )
    true = {(effect.name, effect.place): set(effect.values) for effect in case.effects}
    for finding in result["findings"]:
        sizes = {size["name"].removeprefix("ln_") for size in finding["sizes"]}
        for unknown in sizes - true.get((finding["effect"], finding["place"]), sizes):
            effect = finding["effect"]
            raise BadRequest(f"{case.name}: {effect} has no {unknown}; remove its result and solve again")


def leave_out(context: Context, maker: ArmCases, cases: int) -> Document:
    """Diagnose solved cases with one clear effect again, with a catalogue that lacks it.

    Of the cases in the folder, so many are taken, those with the largest effects.
    """
    folder = context.out or Path(f"{maker.name}-{context.seed}")
    truth, results = sealed.load_truth(folder, maker), sealed.load_results(folder)
    classes = load_classes(folder / CAMPAIGN_FOLDER)
    chosen = list_clear_cases([case for case in truth.cases if case.name in results], classes)[:cases]
    if not chosen:
        raise BadRequest(f"{folder}: no solved case has one effect above its limit; solve all cases")
    maker.prepare(folder, context.run, context.progress)
    jobs = [(folder.absolute(), maker, case) for case in chosen]
    documents = list(in_order(context.run, diagnose_without, jobs))
    return score_left_out(classes, list(zip(chosen, documents, strict=True)))


def list_clear_cases(cases: Sequence[TrueCase], classes: EquivalenceClasses) -> list[TrueCase]:
    """List the cases with one effect from the limit of the selection on, the largest first."""
    sizes = {case.name: classes.times_limit(*case.effects) for case in cases if case.kind == "single"}
    clear = (case for case in cases if sizes.get(case.name, 0.0) >= 1.0)
    return sorted(clear, key=lambda case: sizes[case.name], reverse=True)


def diagnose_without(folder: Path, maker: ArmCases, case: TrueCase) -> Document:
    """Diagnose a case without its effect in the catalogue."""
    try:
        return maker.diagnose(folder, sealed.case_path(folder, maker, case.name), case.effects[0].name)
    except NO_DIAGNOSIS:
        return {"verdict": "unknown", "findings": []}


def score_left_out(classes: EquivalenceClasses, solved: Sequence[tuple[TrueCase, Document]]) -> Document:
    """Count cases in which another effect is named, anything is reported, and a place is right."""
    wrong, right = [], []
    for case, document in solved:
        (effect,) = case.effects
        named = [f"{o['effect']} at {o['place']}" for o in document["findings"] if o["level"] == "effect"]
        if named:
            wrong.append(f"{case.name}: {effect.name} at {effect.place}: {', '.join(named)}")
        located = [one for one in document["findings"] if one["level"] != "none"]
        places = [set(one["not_excluded"]["places"]) for one in located]
        if places:
            right.append(all(classes.locations(effect.name, effect.place) & one for one in places))
    reported = [one["verdict"] != "none" for _, one in solved]
    named_rate = rate_of([True] * len(wrong) + [False] * (len(solved) - len(wrong)))
    rates = {"named": named_rate, "reported": rate_of(reported), "right_place": rate_of(right)}
    return {**to_json(rates), "wrong": wrong}


def campaign(
    context: Context,
    cases: int = 200,
    step: str = "all",
    partial: bool = False,
    small: bool = False,
    arm: str = NOMINAL_ARM,
    sessions: str = "*",
) -> Document:
    """Make, solve and score blind cases.

    Args:
        context: Its folder holds the cases; arm-cases-SEED if it names none.
        cases: Number of cases.
        step: all, make, solve, score or leave-out.
        partial: Score only cases that are solved.
        small: Two sessions and one kind of effect, a minute in all.
        arm: Name of an arm of its drawing.
        sessions: Pattern of the names of the sessions, such as poses-*.
    """
    names = tuple(one.name for one in choose_sessions(None, arm) if fnmatchcase(one.name, sessions))
    maker = ArmCases(SMALL_SESSIONS, SMALL_KINDS) if small else ArmCases(names, None, arm)
    if step == "leave-out":
        return leave_out(context, maker, cases)
    return sealed.run_steps(context, maker, cases, step, partial, is_kept=not small)
