"""Score of a folder of blind cases: checks the seal of the truth, and loads what is compared."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.blind_case import TrueCase, load_truth
from marsarm.diagnosis.problem import Hypothesis
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from validation.blind.case_features import (
    CampaignSensitivities,
    closure_of_truth,
    read_case_parts,
)
from validation.blind.classes import load_classes, load_outside_effects
from validation.blind.folder import CAMPAIGN_FOLDER, CASES_FOLDER, load_results
from validation.blind.score import ResultDocument, Score, score
from validation.blind.solve import DIAGNOSIS_SEED, features_path


def score_folder(
    folder: Path,
    kept_in: Callable[[Path], CampaignSensitivities],
    partial: bool,
    progress: Progress = lambda *_: None,
) -> Score:
    """Score the cases of a folder.

    Args:
        folder: Folder of blind cases.
        kept_in: Function that loads the sensitivities of a campaign folder.
        partial: Score only solved cases, instead of refusing a folder with unsolved ones.
        progress: Called with done, total and case.

    Raises:
        BadRequest: The truth does not match its digest, cases are unsolved, or a result is damaged.
    """
    truth, results = load_truth(folder), load_results(folder)
    open_cases = [case.name for case in truth.cases if case.name not in results]
    if open_cases and (not partial or len(open_cases) == len(truth.cases)):
        raise BadRequest(
            f"{folder}: {len(open_cases)} of {len(truth.cases)} cases are not solved, {open_cases[0]} first; "
            f"`python -m validation.blind solve` continues, --partial scores those that are solved"
        )
    sensitivities, done = kept_in(folder / CAMPAIGN_FOLDER), 0

    def true_closure(case: TrueCase) -> float:
        nonlocal done
        progress(done, len(results), case.name)
        done += 1
        parts = read_case_parts(features_path(folder / CASES_FOLDER / case.name), sensitivities)
        return closure_of_truth(*parts, _true_values(sensitivities, case), DIAGNOSIS_SEED).share

    solved = [(case, results[case.name]) for case in truth.cases if case.name in results]
    for case, result in solved:
        _check_outside(case)
        _check_sizes(case, result)
    return score(load_classes(folder / CAMPAIGN_FOLDER), solved, true_closure)


def _check_outside(case: TrueCase) -> None:
    """Raise BadRequest if today's effects outside the catalogue lack that of a case."""
    for effect in case.effects if case.kind == "out-of-catalogue" else ():
        if effect.name not in load_outside_effects():
            raise BadRequest(
                f"{case.name}: {effect.name} is none of today's effects outside the catalogue; score it with "
                f"the marsarm that made it"
            )


def _check_sizes(case: TrueCase, result: ResultDocument) -> None:
    """Raise BadRequest if a result gives a true effect a parameter that it does not have."""
    true = {(effect.name, effect.place): set(effect.values) for effect in case.effects}
    for finding in result["effects"]:
        sizes = {parameter["name"] for parameter in finding["parameters"] if parameter["is_amplitude"]}
        for unknown in sizes - true.get((finding["name"], finding["place"]), sizes):
            raise BadRequest(
                f"{case.name}: {finding['name']} has no {unknown}; remove its result and solve again"
            )


def _true_values(sensitivities: CampaignSensitivities, case: TrueCase) -> dict[Hypothesis, Array]:
    """Return the true effects as hypotheses of the campaign."""
    known = {(one.effect, one.place): one for one in sensitivities.fitted.hypotheses}
    unknown = [effect for effect in case.effects if (effect.name, effect.place) not in known]
    if unknown:
        raise BadRequest(
            f"{case.name}: {unknown[0].name} at {unknown[0].place} is not in today's catalogue; "
            f"score it with the marsarm that made it"
        )
    found = [(known[effect.name, effect.place], effect.values) for effect in case.effects]
    for one, values in found:
        if missing := {p.name for p in one.parameters} - values.keys():
            raise BadRequest(
                f"{case.name}: {one.name} has no {min(missing)} in the truth, so nothing is compared"
            )
    return {one: np.array([values[p.name] for p in one.parameters]) for one, values in found}
