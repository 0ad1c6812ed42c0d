"""The Monte Carlo's work: one arm is one job, and one record of what was measured on it."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from fsw.config import digest
from fsw.dictionary.enums import Tool
from fsw.dictionary.params import Params
from ground.accuracy.places import Measured
from ground.accuracy.sources import error_model
from ground.accuracy.trial import How, built_trial, drawn_trial
from ground.common.checkpoint import ResultsFile
from ground.common.pool import Runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest

Built = Literal["drawn", "calibrated", "as-built"]


@dataclass(frozen=True, slots=True)
class ArmJob:
    """One arm of a Monte Carlo: by itself it gives the same as among others."""

    case: str
    built: Built
    """drawn: the nominal arm with every source of the case. calibrated, as-built: an arm of that name with
    those that it has not got itself."""
    places: int
    how: How
    seed: int
    arm: int
    params: Params
    """What flight software believes; of a calibrated arm, what its calibration was begun with."""


def run_job(job: ArmJob) -> dict[str, Any]:
    """What was measured on the arm, or why a move on it did not end, as a record for JSON."""
    model = error_model()
    case, seed = model.case[job.case], np.random.SeedSequence(job.seed, spawn_key=(job.arm,))
    try:
        if job.built == "drawn":
            found = drawn_trial(model, case, job.params, job.places, job.how, seed)
        else:
            name = f"{job.built}:{job.seed + job.arm}"
            found = built_trial(model, case, name, job.params, job.places, job.how, seed)
    except RuntimeError as error:
        return {**_of(job), "failed": str(error)}
    return {**_of(job), "tool": found[0].tool.name.lower(), "places": [_as_record(m) for m in found]}


def _of(job: ArmJob) -> dict[str, Any]:
    return {"arm": job.arm, "params_sha256": digest(job.params)}


def run_jobs(
    jobs: Sequence[ArmJob], runner: Runner, results: ResultsFile | None, progress: Progress
) -> list[dict[str, Any]]:
    """The records of all jobs in their order; those that the file has already are not done again.

    Raises:
        BadRequest: an arm had other parameters when it was done.
    """
    wanted = {job.arm: digest(job.params) for job in jobs}
    known = [] if results is None else [record for record in results.done if record["arm"] in wanted]
    for record in known:
        if record["params_sha256"] != wanted[record["arm"]]:
            raise BadRequest(
                f"results: arm {record['arm']} in it was run with other parameters; give the path of a new "
                "file"
            )
    records = {record["arm"]: record for record in known}
    missing = [job for job in jobs if job.arm not in records]
    progress(len(records), len(jobs), "arms")
    for record in runner(run_job, missing):
        records[record["arm"]] = record
        if results is not None:
            results.add(record)
        progress(len(records), len(jobs), "arms")
    return [records[job.arm] for job in jobs]


def check_record(record: dict[str, Any]) -> None:
    """See that it is of an arm; KeyError, TypeError or ValueError if it is not."""
    if not isinstance(record["arm"], int) or not isinstance(record["params_sha256"], str):
        raise TypeError("arm and params_sha256 are a number and a digest")
    list(measured_in(record))


def measured_in(record: dict[str, Any]) -> Iterator[Measured]:
    """What a record of an arm tells."""
    for place in record.get("places", ()):
        output, error, gap = (np.array(place[name]) for name in ("output_rad", "error", "gap"))
        yield Measured(Tool[record["tool"].upper()], output, error, gap)


def _as_record(measured: Measured) -> dict[str, Any]:
    values = asdict(measured)
    return {name: values[name].tolist() for name in ("output_rad", "error", "gap")}
