"""Leave-one-effect-out: solved cases again, with a catalogue that lacks their effect."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from marsarm.common.pool import Runner, in_order
from marsarm.common.rates import Rate, estimate_rate
from marsarm.diagnosis.blind_case import TrueCase, load_truth
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from validation.blind.classes import EquivalenceClasses, load_classes
from validation.blind.folder import CAMPAIGN_FOLDER, CASES_FOLDER, load_results
from validation.blind.score import NAMED_LEVELS
from validation.blind.solve import NoDiagnosis, Solver


@dataclass(frozen=True, slots=True)
class LeftOutScore:
    """Result of cases whose effect is left out of the catalogue."""

    named: Rate
    """Cases in which another effect is named as the cause."""
    reported: Rate
    """Cases in which anything is reported."""
    right_place: Rate
    """Cases with findings of which all that have places hold the location of the effect."""
    wrong: tuple[str, ...]
    """The effect and what was named in its place, a text a case."""


def score_left_out(folder: Path, solver: Solver, cases: int, run: Runner, progress: Progress) -> LeftOutScore:
    """Diagnose cases with one effect without that effect in the catalogue.

    Args:
        folder: Folder of solved blind cases.
        solver: Solver of the cases.
        cases: Greatest number of cases; those with the largest effects are taken.
        run: Runner of parallel jobs.
        progress: Called with done, total and case.

    Raises:
        BadRequest: A number is below 1, or no solved case has one clear effect.
    """
    if cases < 1:
        raise BadRequest(f"cases: {cases} is not 1 or more")
    truth, results = load_truth(folder), load_results(folder)
    classes = load_classes(folder / CAMPAIGN_FOLDER)
    solved = [case for case in truth.cases if case.name in results]
    chosen = list_clear_cases(solved, classes)[:cases]
    if not chosen:
        raise BadRequest(
            f"{folder}: no solved case has one effect of the catalogue above its detection limit; "
            f"`python -m validation.blind solve` solves all cases"
        )
    solver.prepare_campaign(folder / CAMPAIGN_FOLDER, run, progress)
    jobs = [(folder.absolute(), case, solver) for case in chosen]
    documents = []
    for done, document in enumerate(in_order(run, _diagnose_without, jobs), 1):
        documents.append(document)
        progress(done, len(jobs), "left out")
    return _score(classes, list(zip(chosen, documents, strict=True)))


def list_clear_cases(cases: Sequence[TrueCase], classes: EquivalenceClasses) -> list[TrueCase]:
    """List the cases with one effect from the limit of the selection on, the largest first."""
    single = [case for case in cases if case.kind == "single"]
    size = {
        case.name: one.times_limit / classes.family_wise_share(one.name, one.place)
        for case in single
        for one in case.effects
    }
    return sorted((case for case in single if size[case.name] >= 1.0), key=lambda case: -size[case.name])


def _diagnose_without(folder: Path, case: TrueCase, solver: Solver) -> dict[str, Any]:
    (effect,) = case.effects
    try:
        return solver.diagnose(folder / CASES_FOLDER / case.name, folder / CAMPAIGN_FOLDER, effect.name)[0]
    except NoDiagnosis:
        return {"verdict": "unknown", "effects": []}


def _score(classes: EquivalenceClasses, solved: Sequence[tuple[TrueCase, dict[str, Any]]]) -> LeftOutScore:
    wrong = list(_wrong_names(solved))
    found = [(case, one) for case, one in solved if any(finding["places"] for finding in one["effects"])]
    right = [
        all(
            classes.locations(case.effects[0].name, case.effects[0].place) & set(finding["places"])
            for finding in one["effects"]
            if finding["places"]
        )
        for case, one in found
    ]
    reported = sum(one["verdict"] != "none" for _, one in solved)
    return LeftOutScore(
        estimate_rate(len(wrong), len(solved)),
        estimate_rate(reported, len(solved)),
        estimate_rate(sum(right), len(right)),
        tuple(wrong),
    )


def _wrong_names(solved: Sequence[tuple[TrueCase, dict[str, Any]]]) -> Iterator[str]:
    for case, document in solved:
        named = [one for one in document["effects"] if one["level"] in NAMED_LEVELS]
        if named:
            (effect,) = case.effects
            others = ", ".join(f"{one['name']} at {one['place']}" for one in named)
            yield f"{case.name}: {effect.name} at {effect.place}: {others}"
