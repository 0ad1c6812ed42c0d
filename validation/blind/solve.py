"""Solving of blind cases: the diagnosis of every case without a result."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from marsarm.common.pool import Runner
from simgap.common.progress import Progress
from validation.blind.case_features import CampaignSensitivities, CaseFeatures
from validation.blind.folder import CAMPAIGN_FOLDER, list_cases, result_path, write_json

DIAGNOSIS_SEED: Final = 1
"""Seed of the diagnosis, independent of the seed of the cases."""


class NoDiagnosis(ValueError):
    """Case that cannot be diagnosed; the message says why."""


@dataclass(frozen=True, slots=True)
class Solver:
    """Functions that solve the cases of a robot, at module level so that other processes can import them."""

    prepare_campaign: Callable[[Path, Runner, Progress], object]
    """Compute what is not cached yet of the campaign in a folder, in parallel."""
    load_sensitivities: Callable[[Path], CampaignSensitivities]
    """Load the sensitivities of the campaign in a folder."""
    diagnose: Callable[[Path, Path, str], tuple[dict[str, Any], CaseFeatures]]
    """Diagnose a case's folder with the campaign's folder, without the effect of a name in the catalogue, or
    "" for none; return result document and residuals.

    Raises NoDiagnosis if the case cannot be diagnosed.
    """


@dataclass(frozen=True, slots=True)
class _Job:
    case: Path
    solver: Solver


def solve_cases(folder: Path, solver: Solver, run: Runner, progress: Progress) -> tuple[int, int]:
    """Solve all cases without a result; never read the truth.

    Returns:
        Number of cases solved now, and number of all cases.

    Raises:
        BadRequest: This is no folder of blind cases.
        BadOutput: A result cannot be written.
    """
    cases = list_cases(folder)
    jobs = [_Job(case.absolute(), solver) for case in cases if not result_path(case).exists()]
    if jobs:  # before the pool starts, else every process would compute it
        solver.prepare_campaign(folder / CAMPAIGN_FOLDER, run, progress)
    for done, name in enumerate(run(_solve_case, jobs), 1):
        progress(done, len(jobs), name)
    return len(jobs), len(cases)


def features_path(case: Path) -> Path:
    """Return the path of the residuals of a solved case."""
    return result_path(case).with_suffix(".features.json")


def _solve_case(job: _Job) -> str:
    """Solve one case; its result is written last, so that an interrupted case is solved again."""
    campaign = job.case.parent.parent / CAMPAIGN_FOLDER
    job.solver.load_sensitivities(campaign)  # what is known before a case is no part of its time
    began = time.process_time()
    try:
        result, features = job.solver.diagnose(job.case, campaign, "")
    except NoDiagnosis as why:
        write_json(result_path(job.case), _refusal(str(why), time.process_time() - began))
        return job.case.name
    seconds = time.process_time() - began
    write_json(features_path(job.case), features.document())
    write_json(result_path(job.case), {**result, "seconds": seconds})
    return job.case.name


def _refusal(why: str, seconds: float) -> dict[str, Any]:
    """Return the result of a case that cannot be diagnosed: "unknown", without effects."""
    return {"verdict": "unknown", "refused": why, "effects": [], "closure": None, "seconds": seconds}
