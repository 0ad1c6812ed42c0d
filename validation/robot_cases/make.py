"""Making of the cases: truth drawn and sealed, then robot files and logs. An interrupted run goes on."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter

from marsarm.common.pool import Runner
from marsarm.diagnosis.blind_case import DIGEST
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from validation.blind.folder import write_json
from validation.robot_cases.arms import ARMS, load_robot
from validation.robot_cases.draw import draw_truth, make_campaign, record_logs
from validation.robot_cases.equivalents import find_equivalents
from validation.robot_cases.motions import HELD_OUT, PLAN
from validation.robot_cases.seal import (
    SEALED_FOLDER,
    PlannedCase,
    SealedCase,
    SealedTruth,
    load_truth,
    plan_cases,
    salt,
    seal,
)
from validation.robot_cases.write import write_logs, write_robot

CASES_FOLDER: Final = "cases"
ROBOTS_FOLDER: Final = "robots"
INDEX_FILE: Final = "cases.json"
"""Robot of each case: all that `solve` is told."""
_CASE: Final = TypeAdapter(SealedCase)


@dataclass(frozen=True, slots=True)
class _Draw:
    folder: Path
    plan: PlannedCase


@dataclass(frozen=True, slots=True)
class _Record:
    folder: Path
    case: SealedCase


def make_cases(
    folder: Path,
    count: int,
    seed: int,
    run: Runner,
    progress: Progress,
    publish: Callable[[str], None],
    models: tuple[str, ...] = tuple(ARMS),
) -> str:
    """Draw and seal the truth, publish its digest, then write the files; return the digest.

    Args:
        folder: Folder of the cases; a new one, or one to continue.
        count: Number of cases.
        seed: Seed of everything, 1 or more.
        run: Runner of parallel jobs.
        progress: Called with done, total and case.
        publish: Called with the digest before a log is recorded.
        models: Robots.

    Raises:
        BadRequest: The folder holds cases of another seed or number.
    """
    truth = _sealed_truth(folder, count, seed, run, progress, models)
    publish(truth.digest())
    for model in models:
        names = tuple(name for name, _ in PLAN)
        write_robot(folder / ROBOTS_FOLDER / model, load_robot(model), HELD_OUT, names)
    write_json(folder / INDEX_FILE, {case.name: case.truth.model for case in truth.cases})
    (folder / CASES_FOLDER).mkdir(exist_ok=True)
    jobs = [_Record(folder, case) for case in truth.cases if not log_path(folder, case.name).exists()]
    for done, name in enumerate(run(_record, jobs), 1):
        progress(done, len(jobs), f"recorded {name}")
    return truth.digest()


def log_path(folder: Path, case: str) -> Path:
    """Return the path of the log of a case."""
    return folder / CASES_FOLDER / f"{case}.parquet"


def read_index(folder: Path) -> dict[str, str]:
    """Read the robots of the cases."""
    try:
        found: dict[str, str] = json.loads((folder / INDEX_FILE).read_bytes())
    except (OSError, ValueError) as error:
        raise BadRequest(f"{folder}: is no folder of cases ({error}); make makes one") from error
    return found


def _sealed_truth(
    folder: Path, count: int, seed: int, run: Runner, progress: Progress, models: tuple[str, ...]
) -> SealedTruth:
    if (folder / DIGEST).exists():
        truth = load_truth(folder)
        if (truth.salt, len(truth.cases)) != (salt(seed), count):
            raise BadRequest(f"out {folder}: holds cases of another seed or number; give a new folder")
        return truth
    (folder / SEALED_FOLDER).mkdir(parents=True, exist_ok=True)
    plans = plan_cases(count, seed, models)
    jobs = [_Draw(folder, plan) for plan in plans if not _draft_path(folder, plan.name).exists()]
    for done, name in enumerate(run(_draw, jobs), 1):
        progress(done, len(jobs), f"drew {name}")
    drafts = [_CASE.validate_json(_draft_path(folder, plan.name).read_bytes()) for plan in plans]
    if any(
        (one.truth.seed, one.truth.kind) != (plan.seed, plan.kind)
        for one, plan in zip(drafts, plans, strict=True)
    ):
        raise BadRequest(f"out {folder}: holds drafts of another seed or number; give a new folder")
    truth = SealedTruth(salt(seed), tuple(drafts))
    seal(folder, truth)
    return truth


def _draft_path(folder: Path, case: str) -> Path:
    return folder / SEALED_FOLDER / f"{case}.json"


def _draw(job: _Draw) -> str:
    plan = job.plan
    truth = draw_truth(plan.seed, plan.kind, plan.model)
    campaign = make_campaign(plan.seed, plan.model)
    equivalents = tuple(find_equivalents(campaign, one) for one in truth.effects)
    write_json(_draft_path(job.folder, plan.name), asdict(SealedCase(plan.name, truth, equivalents)))
    return plan.name


def _record(job: _Record) -> str:
    write_logs(log_path(job.folder, job.case.name), record_logs(job.case.truth))
    return job.case.name
