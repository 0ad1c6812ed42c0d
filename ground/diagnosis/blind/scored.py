"""A folder of blind cases scored: first the seal, then what was said against what was true."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.blind.classes import classes_in
from ground.diagnosis.blind.closing import tried, truth_closes
from ground.diagnosis.blind.evidence import Kept, parts, read_features
from ground.diagnosis.blind.folder import CAMPAIGN, CASES, documents
from ground.diagnosis.blind.score import Document, Score, score
from ground.diagnosis.blind.solve import SEED, features_path
from ground.diagnosis.blind.truth import TrueCase, unsealed
from ground.diagnosis.hypothesis import Hypothesis


def scored(
    folder: Path, kept_in: Callable[[Path], Kept], partial: bool, progress: Progress = lambda *_: None
) -> Score:
    """Of all cases; `partial` of those that are solved.

    Raises:
        BadRequest: the truth is not what was sealed, cases are not solved, or what was said is damaged.
    """
    truth, said = unsealed(folder), documents(folder)
    open_cases = [case.name for case in truth.cases if case.name not in said]
    if open_cases and (not partial or len(open_cases) == len(truth.cases)):
        raise BadRequest(
            f"{folder}: {len(open_cases)} of {len(truth.cases)} cases are not solved, {open_cases[0]} first; "
            f"`marsarm gap blind solve` goes on where it was, --partial scores those that are"
        )
    kept, done = kept_in(folder / CAMPAIGN), 0

    def true_closure(case: TrueCase) -> float:
        nonlocal done
        progress(done, len(said), case.name)
        done += 1
        features = read_features(features_path(folder / CASES / case.name))
        return truth_closes(tried(*parts(kept, features)), _settings(kept, case), SEED).share

    solved = [(case, said[case.name]) for case in truth.cases if case.name in said]
    for case, told in solved:
        _check_sizes(case, told)
    return score(classes_in(folder / CAMPAIGN), solved, true_closure)


def _check_sizes(case: TrueCase, said: Document) -> None:
    """BadRequest if a true effect was given a size that it has not."""
    true = {(effect.name, effect.place): set(effect.values) for effect in case.effects}
    for finding in said["effects"]:
        sizes = {told["name"] for told in finding["parameters"] if told["is_size"]}
        for strange in sizes - true.get((finding["name"], finding["place"]), sizes):
            raise BadRequest(
                f"{case.name}: {finding['name']} has no {strange}; remove what was said of it and solve again"
            )


def _settings(kept: Kept, case: TrueCase) -> dict[Hypothesis, Array]:
    """The true effects as the campaign's hypotheses."""
    known = {(one.effect, one.place): one for one in kept.fitted.hypotheses}
    strange = [effect for effect in case.effects if (effect.name, effect.place) not in known]
    if strange:
        raise BadRequest(
            f"{case.name}: {strange[0].name} at {strange[0].place} is not in today's catalogue; "
            f"score it with the marsarm that made it"
        )
    found = [(known[effect.name, effect.place], effect.values) for effect in case.effects]
    return {one: np.array([values[p.name] for p in one.parameters]) for one, values in found}
