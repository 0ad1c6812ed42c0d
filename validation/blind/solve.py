"""Every blind case that is not solved yet: what the diagnosis says of it, and what others say."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ground.common.pool import Runner
from ground.common.progress import Progress
from validation.blind.baselines import baselines
from validation.blind.case_features import CampaignSensitivities, CaseFeatures, prepare_trial, split_case
from validation.blind.folder import CAMPAIGN_FOLDER, list_cases, result_path, write_json

DIAGNOSIS_SEED: Final = 1
"""Of what is drawn in a diagnosis; it has nothing to do with that of the cases."""


class NoDiagnosis(ValueError):
    """A case that a solver cannot say anything of; the message says why."""


@dataclass(frozen=True, slots=True)
class Solver:
    """How a robot's cases are solved: functions of modules, so that other processes find them."""

    prepare_campaign: Callable[[Path, Runner, Progress], object]
    """Computes what is not kept yet of the campaign in a folder, with all that can work."""
    load_sensitivities: Callable[[Path], CampaignSensitivities]
    """The campaign in a folder."""
    diagnose: Callable[[Path, Path], tuple[dict[str, Any], CaseFeatures]]
    """What is said of a case's folder, beside the campaign's: what `marsarm diagnose --json` says.

    And what its logs say, for the baselines and for what the truth would achieve. NoDiagnosis if it cannot.
    """


@dataclass(frozen=True, slots=True)
class _Job:
    case: Path
    solver: Solver


def solve_cases(folder: Path, solver: Solver, run: Runner, progress: Progress) -> tuple[int, int]:
    """How many cases were solved now, and how many are by now. The truth is never looked at.

    Raises:
        BadRequest: this is no folder of blind cases.
        BadOutput: a result cannot be written.
    """
    cases = list_cases(folder)
    jobs = [_Job(case, solver) for case in cases if not result_path(case).exists()]
    if jobs:  # else every process would compute it for itself
        solver.prepare_campaign(folder / CAMPAIGN_FOLDER, run, progress)
    for done, name in enumerate(run(_solve_case, jobs), 1):
        progress(done, len(jobs), name)
    return len(jobs), len(cases)


def features_path(case: Path) -> Path:
    """Where the features of a solved case are kept."""
    return result_path(case).with_suffix(".features.json")


def _solve_case(job: _Job) -> str:
    """One case; only its result is written last, so that a case that was cut short is solved again."""
    campaign = job.case.parent.parent / CAMPAIGN_FOLDER
    kept = job.solver.load_sensitivities(campaign)  # what is known before a case is no part of its time
    began = time.process_time()
    try:
        said, features = job.solver.diagnose(job.case, campaign)
    except NoDiagnosis as why:
        write_json(result_path(job.case), _refusal(str(why), time.process_time() - began))
        return job.case.name
    seconds = time.process_time() - began
    others = baselines(prepare_trial(*split_case(kept, features)), DIAGNOSIS_SEED)
    write_json(features_path(job.case), features.document())
    write_json(result_path(job.case), {**said, "seconds": seconds, "baselines": others})
    return job.case.name


def _refusal(why: str, seconds: float) -> dict[str, Any]:
    """Nothing is said, and it counts as that."""
    nothing: dict[str, Any] = {"effects": [], "ranking": [], "closure": None, "baselines": {}}
    return {"verdict": "unknown", "refused": why, **nothing, "seconds": seconds}
