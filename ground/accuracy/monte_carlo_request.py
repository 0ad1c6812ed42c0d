"""The Monte Carlo as it is asked for on the command line."""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any, Final, cast, get_args

import numpy as np

from fsw.config import configure, digest
from ground.accuracy.budget import COMPONENTS
from ground.accuracy.combine import PARTS
from ground.accuracy.judged import Judged, judged
from ground.accuracy.monte_carlo import ArmJob, Built, check_record, measured_in, run_jobs
from ground.accuracy.places import Measured
from ground.accuracy.sources import ErrorModel, error_model
from ground.accuracy.trial import How
from ground.accuracy.variance import Spreads, spreads
from ground.common.checkpoint import ResultsFile
from ground.common.files import BadOutput, check_output
from ground.common.pool import on_cluster, on_this_machine
from ground.common.progress import Progress
from ground.common.requests import BadRequest, check_apart, check_seed, chosen_arm, params_for
from sim.world import World

ARMS: Final = (1, 1_000_000)
PLACES: Final = (1, 1000)
WORKERS: Final = (1, 1000)
"""At least, at most."""
SEED: Final = "{seed}"


@dataclass(frozen=True, slots=True)
class MonteCarloRequest:
    """What is asked."""

    case: str = "accuracy"
    built: str = "drawn"
    arms: int = 500
    places: int = 1
    how: str = "closed-loop"
    seed: int = 0
    only: int | None = None
    workers: int = 1
    cluster: bool = False
    params: Path | None = None
    results: Path | None = None
    report: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloReport:
    """What came of it."""

    request: MonteCarloRequest
    model: ErrorModel
    trials: tuple[tuple[Measured, ...], ...]
    """Of each arm whose moves all came to their end."""
    failed: Mapping[int, str]
    judged: Judged | None
    """None if there was no arm."""
    spreads: Mapping[str, Spreads] | None
    """Of each of COMPONENTS, where there are arms and places enough."""


def monte_carlo_report(request: MonteCarloRequest, progress: Progress) -> MonteCarloReport:
    """Arms of a case, moved and measured, against the budget.

    Raises:
        BadRequest: the request is wrong; nothing was moved or written.
    """
    model = error_model()
    _check(request, model)
    jobs = _jobs(request)
    runner = on_cluster() if request.cluster else on_this_machine(request.workers)
    file = (
        None if request.results is None else ResultsFile(request.results, _told(request, jobs), check_record)
    )
    with nullcontext() if file is None else file:
        records = run_jobs(jobs, runner, file, progress)
    failed = {record["arm"]: record["failed"] for record in records if "failed" in record}
    trials = tuple(tuple(measured_in(record)) for record in records if "failed" not in record)
    gravity = World().gravity_N_m_s2
    found = judged(model, request.case, configure(jobs[0].params), gravity, trials) if trials else None
    return MonteCarloReport(request, model, trials, failed, found, _spreads(trials))


def _check(request: MonteCarloRequest, model: ErrorModel) -> None:
    _known("case", request.case, tuple(model.case))
    _known("built", request.built, get_args(Built))
    _known("how", request.how, get_args(How))
    for name, bounds in (("arms", ARMS), ("places", PLACES), ("workers", WORKERS)):
        _within(name, getattr(request, name), bounds)
    if request.only is not None:
        _within("only", request.only, (0, request.arms - 1))
    check_seed(request.seed)
    check_apart({"params": request.params, "report": request.report, "results": request.results})
    try:
        if request.report is not None:
            check_output(request.report, (".html",), "report")
        if request.results is not None:
            check_output(request.results, (".jsonl",), "results")
    except BadOutput as error:
        raise BadRequest(str(error)) from error


def _jobs(request: MonteCarloRequest) -> list[ArmJob]:
    arms = range(request.arms) if request.only is None else [request.only]
    built, how = cast(Built, request.built), cast(How, request.how)
    if _are_of_arms(request.params):
        numbers = [request.seed + arm for arm in arms]
        names = ["nominal" if request.built == "drawn" else f"{request.built}:{number}" for number in numbers]
        paths = [Path(str(request.params).replace(SEED, str(number))) for number in numbers]
        params = [params_for(name, path) for name, path in zip(names, paths, strict=True)]
    else:
        params = [chosen_arm("nominal", request.params).params] * len(arms)
    return [
        ArmJob(request.case, built, request.places, how, request.seed, arm, own)
        for arm, own in zip(arms, params, strict=True)
    ]


def _are_of_arms(params: Path | None) -> bool:
    """Whether every arm has a file of its own."""
    return params is not None and SEED in str(params)


def _told(request: MonteCarloRequest, jobs: list[ArmJob]) -> dict[str, Any]:
    """What results depend on, but for how many arms there are: more can be added."""
    sources = resources.files("ground.accuracy").joinpath("sources.toml").read_bytes()
    same = ("case", "built", "places", "how", "seed")
    return {
        **{name: value for name, value in asdict(request).items() if name in same},
        "params": str(request.params) if _are_of_arms(request.params) else digest(jobs[0].params),
        "sources": sha256(sources).hexdigest(),
    }


def _spreads(trials: tuple[tuple[Measured, ...], ...]) -> dict[str, Spreads] | None:
    if len(trials) < 2 or len(trials[0]) < 2:
        return None
    error = np.array([[m.error for m in trial] for trial in trials]).transpose(2, 0, 1)
    return {name: spreads(error[part]) for name, part in zip(COMPONENTS, PARTS, strict=True)}


def _known(name: str, value: str, there: tuple[str, ...]) -> None:
    if value not in there:
        raise BadRequest(f"{name}: {value!r} is not known; there are {', '.join(there)}")


def _within(name: str, value: int, bounds: tuple[int, int]) -> None:
    least, most = bounds
    if not least <= value <= most:
        raise BadRequest(f"{name}: {value} is not within {least} .. {most}")
