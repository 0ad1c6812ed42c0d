"""Monte Carlo of arms as a request of the command line: jobs, checkpoints, and comparison with the budget.

A checkpoint has one JSON line for each result; its first line is the request. An incomplete last line is
discarded, and its job is repeated. Results of another request are refused.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.params import Params, digest
from fsw.kinematics.transforms import Array
from marsarm.accuracy.budget import COMPONENTS, Budget, compute_tool_budget
from marsarm.accuracy.propagation import (
    COVERAGE,
    PARTS,
    ErrorModel,
    Poses,
    bounds,
    compute_sensitivity,
    load_error_model,
    sources_sha256,
)
from marsarm.accuracy.request import MonteCarloRequest
from marsarm.accuracy.trial import MeasuredPlacement, run_trial
from marsarm.common.pool import Runner, select_runner
from marsarm.common.rates import (
    AccuracyEstimate,
    Coverage,
    Interval,
    estimate_accuracy,
    estimate_coverage,
    quantile_interval,
)
from marsarm.common.requests import select_arm
from sim.setting import World
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress

REQUEST: Final = "request"
NEW_FILE: Final = "give the path of a new file"


class Checkpoint:
    """Open file of results; a context manager."""

    def __init__(
        self, path: Path, request: Mapping[str, Any], read: Callable[[dict[str, Any]], object] = dict
    ):
        """Open the file, or make it, and check what it holds.

        Args:
            request: The request, comparable after a round trip through JSON.
            read: Parser of one result, which raises KeyError, TypeError or ValueError for anything else.

        Raises:
            BadRequest: The file cannot be read or written, has another format, or belongs to another request.
        """
        self._path = path
        self._request = json.loads(json.dumps(request))
        self.done: list[dict[str, Any]] = []
        """Results that the file held when it was opened."""
        try:
            complete_bytes = self._read(read) if os.path.exists(path) else 0
            self._file = path.open("ab")
            self._file.truncate(complete_bytes)
            if complete_bytes == 0:
                self.add({REQUEST: self._request})
        except OSError as error:
            raise BadRequest(f"results {path}: cannot be written ({error.strerror or error})") from error

    def __enter__(self) -> "Checkpoint":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, result: Mapping[str, Any]) -> None:
        """Write a result, and flush it to the disk."""
        self._file.write(json.dumps(result).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, read: Callable[[dict[str, Any]], object]) -> int:
        """Read the complete lines into `done`, and return their length in bytes."""
        if not os.path.isfile(self._path):
            raise self._refuse("this is not a regular file")
        text, begin = self._path.read_bytes(), f'{{"{REQUEST}"'.encode()
        if not text.startswith(begin) and not begin.startswith(text):
            raise self._refuse("holds something else")
        whole = text[: text.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                result = json.loads(line)
            except ValueError as error:
                raise self._refuse(f"line {number} is not JSON") from error
            if number == 1:
                self._check_request(result[REQUEST])
                continue
            try:
                read(result)
            except (KeyError, TypeError, ValueError) as error:
                raise self._refuse(f"line {number} is no result") from error
            self.done.append(result)
        return len(whole)

    def _check_request(self, recorded: Any) -> None:
        old = recorded if isinstance(recorded, dict) else {}
        if recorded != self._request:
            names = [name for name in self._request if old.get(name) != self._request[name]]
            changes = ", ".join(f"{name} {old.get(name)} there, {self._request[name]} now" for name in names)
            raise self._refuse(f"of another request ({changes})")

    def _refuse(self, why: str) -> BadRequest:
        return BadRequest(f"results {self._path}: {why}; {NEW_FILE}")


MEASURED: Final = ("output_rad", "error", "backlash_position")
"""Arrays of a placement in the results."""


ArmJob = tuple[MonteCarloRequest, Params, int]
"""Request, parameters of flight software, and number of an arm; no result depends on another job.

The parameters are those before its calibration for a calibrated arm.
"""


def run_job(job: ArmJob) -> dict[str, Any]:
    """Simulate and measure one arm; return a JSON record of the measurements or of the reason for failure."""
    (request, params, arm), model = job, load_error_model()
    case, seed = model.case[request.case], np.random.SeedSequence(request.seed, spawn_key=(arm,))
    built = None if request.built == "sampled" else f"{request.built}:{request.seed + arm}"
    try:
        found = run_trial(model, case, built, params, request.places, request.move_model, seed)
    except RuntimeError as error:
        return {"arm": arm, "failed": str(error)}
    return {
        "arm": arm,
        "tool": found[0].tool,
        "places": [{name: getattr(m, name).tolist() for name in MEASURED} for m in found],
    }


def run_jobs(
    jobs: Sequence[ArmJob], runner: Runner, results: Checkpoint | None, progress: Progress
) -> list[dict[str, Any]]:
    """Run all jobs without a record; return all records in order."""
    wanted = {arm for *_, arm in jobs}
    known = () if results is None else results.done
    records = {record["arm"]: record for record in known if record["arm"] in wanted}
    missing = [job for job in jobs if job[-1] not in records]
    progress(len(records), len(jobs), "arms")
    for record in runner(run_job, missing):
        records[record["arm"]] = record
        if results is not None:
            results.add(record)
        progress(len(records), len(jobs), "arms")
    return [records[arm] for *_, arm in jobs]


def check_arm_record(record: dict[str, Any]) -> None:
    """Check that a record describes an arm; KeyError, TypeError or ValueError if not."""
    if not isinstance(record["arm"], int):
        raise TypeError("arm is a number")
    list(read_measurements(record))


def read_measurements(record: dict[str, Any]) -> Iterator[MeasuredPlacement]:
    """Read the measurements of an arm from its record."""
    for place in record.get("places", ()):
        output, error, position = (np.array(place[name]) for name in MEASURED)
        yield MeasuredPlacement(str(record["tool"]), output, error, position)


@dataclass(frozen=True, slots=True, eq=False)
class CoverageReport:
    """Comparison of a Monte Carlo with the budget."""

    arms: int
    error: Mapping[str, Array]
    """Errors of each of COMPONENTS, metres or radians, shape (n,)."""
    budget: Budget
    """Budget at the measured poses."""
    percentile: Mapping[str, float]
    """Error length that 99.73 % of the errors do not exceed."""
    percentile_interval: Mapping[str, Interval]
    by_rule: Mapping[str, Mapping[str, Coverage]]
    """Coverage by rule and component."""


def check_coverage(
    model: ErrorModel,
    case: str,
    config: Config,
    gravity_R_m_s2: Array,
    trials: Sequence[Sequence[MeasuredPlacement]],
) -> CoverageReport:
    """Compare the budget of a case with the trials, one trial for each arm."""
    placements = [m for trial in trials for m in trial]
    used = [tool for tool in config.params.tool_names if any(m.tool == tool for m in placements)]
    by_tool = {tool: [m for m in placements if m.tool == tool] for tool in used}
    budgets = {}
    for tool, found in by_tool.items():
        output = np.array([m.output_rad for m in found]).T
        poses = Poses(tool, output, np.full((3, len(found)), np.nan))
        sensitivity = compute_sensitivity(config, poses, gravity_R_m_s2)
        budgets[tool] = compute_tool_budget(model, model.case[case], poses, sensitivity)
    budget = Budget(case, model.case[case], budgets)
    errors = bounds(np.array([m.error for found in by_tool.values() for m in found]).T)
    return CoverageReport(
        arms=len(trials),
        error=errors,
        budget=budget,
        percentile={name: float(np.quantile(e, COVERAGE)) for name, e in errors.items()},
        percentile_interval={name: quantile_interval(e, COVERAGE, len(trials)) for name, e in errors.items()},
        by_rule={
            rule: {
                name: estimate_coverage(errors[name], budget.bounds(rule, name), COVERAGE, len(trials))
                for name in COMPONENTS
            }
            for rule in next(iter(budgets.values())).by_rule
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloReport:
    """Result of a request for a Monte Carlo."""

    request: MonteCarloRequest
    model: ErrorModel
    trials: tuple[tuple[MeasuredPlacement, ...], ...]
    """Measurements of each arm whose moves all succeeded."""
    failed: Mapping[int, str]
    """Reason for failure by index of the arm."""
    coverage: CoverageReport | None
    """Comparison with the budget; None if no arm succeeded."""
    three_sigma: Mapping[str, AccuracyEstimate] | None
    """Accuracy of each of COMPONENTS; None if there are too few arms or placements."""
    params_sha256: str


def run_monte_carlo(request: MonteCarloRequest, progress: Progress = no_progress) -> MonteCarloReport:
    """Simulate and measure arms of a case, beside the budget; BadRequest if the request is wrong."""
    model = load_error_model()
    _check(request, model)
    params = select_arm("nominal", request.params, request.mismatch).params
    params_sha256 = digest(params)
    jobs = [(request, params, arm) for arm in range(request.arms)]
    runner = select_runner(request.workers, request.cluster)
    file = (
        None
        if request.results is None
        else Checkpoint(request.results, _results_header(request, params_sha256), check_arm_record)
    )
    with nullcontext() if file is None else file:
        records = run_jobs(jobs, runner, file, progress)
    failed = {record["arm"]: record["failed"] for record in records if "failed" in record}
    trials = tuple(tuple(read_measurements(record)) for record in records if "failed" not in record)
    gravity = World().gravity_N_m_s2
    found = check_coverage(model, request.case, configure(params), gravity, trials) if trials else None
    three_sigma = None
    if len(trials) > 1 and len(trials[0]) > 1:
        error = np.array([[m.error for m in trial] for trial in trials]).transpose(2, 0, 1)
        three_sigma = {name: estimate_accuracy(error[part]) for name, part in PARTS.items()}
    return MonteCarloReport(request, model, trials, failed, found, three_sigma, params_sha256)


def _check(request: MonteCarloRequest, model: ErrorModel) -> None:
    check_options(request)
    if request.case not in model.case:
        raise BadRequest(f"case: {request.case!r} is not known; there are {', '.join(model.case)}")


def _results_header(request: MonteCarloRequest, params_sha256: str) -> dict[str, Any]:
    """Collect all inputs of the results except the number of arms, so that arms can be added later."""
    same = ("case", "built", "places", "move_model", "seed")
    return {
        **{name: value for name, value in asdict(request).items() if name in same},
        "params": params_sha256,
        "sources": sources_sha256(),
    }
