"""Solving of the cases, one result file a case; the truth is not read. An interrupted run goes on."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from marsarm.common.pool import Runner
from simgap.common.errors import RobotError
from simgap.common.progress import Progress
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.result import Diagnosis
from simgap.robot import Robot
from validation.blind.folder import SOLVED_FOLDER, write_json
from validation.robot_cases.make import ROBOTS_FOLDER, log_path, read_index
from validation.robot_cases.write import ROBOT_FILE

SEED: Final = 1
"""Seed of the diagnosis, independent of that of the cases."""


def diagnose_files(robot_file: Path, log: Path) -> Diagnosis:
    """Diagnose a log as a user does: robot file, logs, split, diagnosis."""
    robot = Robot.from_toml(robot_file)
    logs = load(robot, log)
    return diagnose(robot, logs.fit, held_out=logs.judged, seed=SEED)


@dataclass(frozen=True, slots=True)
class _Job:
    folder: Path
    case: str
    model: str


def solve_cases(folder: Path, run: Runner, progress: Progress) -> tuple[int, int]:
    """Solve all cases without a result; return how many now, and how many there are."""
    index = read_index(folder)
    jobs = [
        _Job(folder.absolute(), case, model)
        for case, model in index.items()
        if log_path(folder, case).exists() and not solved_path(folder, case).exists()
    ]
    for done, case in enumerate(run(_solve, jobs), 1):
        progress(done, len(jobs), case)
    return len(jobs), len(index)


def solved_path(folder: Path, case: str) -> Path:
    """Return the path of the result of a case."""
    return folder / SOLVED_FOLDER / f"{case}.json"


def _solve(job: _Job) -> str:
    robot_file = job.folder / ROBOTS_FOLDER / job.model / ROBOT_FILE
    began = time.process_time()
    try:
        result = to_document(diagnose_files(robot_file, log_path(job.folder, job.case)))
    except RobotError as why:
        result = {"findings": [], "remaining": [], "refused": str(why)}
    result["seconds"] = time.process_time() - began
    write_json(solved_path(job.folder, job.case), result)
    return job.case


def to_document(found: Diagnosis) -> dict[str, Any]:
    """Return what the score needs of a diagnosis, and what a reader wants to know."""
    return {
        "findings": [_finite(asdict(one)) for one in found.findings],
        "remaining": [_finite(asdict(one)) for one in found.remaining],
        "errors": [_finite(asdict(one)) for one in found.errors],
        "refused": "; ".join(one.reason for one in found.refused),
    }


def _finite(value: Any) -> Any:
    """Return a document without NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, float) and not (abs(value) < float("inf")):
        return None
    return value
