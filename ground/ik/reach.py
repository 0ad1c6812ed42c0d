"""What the arm reaches in its primary workspace: how many branches are valid, and why the others are out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.answers import Verdict
from fsw.kinematics.transforms import Array
from ground.ik.model import ArmModel, ModelRequest, Progress, checked_model
from ground.ik.tally import Tally, tally
from ground.ik.targets import Targets
from ground.outputs import BadOutput, check_output
from ground.report.reach_figure import save_reach_figure
from ground.request import BadRequest, check_apart, check_seed
from sim.frames import p_R_from_N
from sim.workspace import approach_from, random_targets

MOST_SAMPLES: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class ReachRequest:
    """What is asked."""

    model: ModelRequest = field(default_factory=ModelRequest)
    samples: int = 20_000
    seed: int = 0
    picture: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ReachSamples:
    """Targets in the workspace, and how many valid branches each has."""

    p_NoTo_N_m: Array
    """(3, n)."""
    angles_rad: Array
    """(2, n): of the approach, below horizontal and to the right of straight ahead."""
    valid: NDArray[np.int64]
    """(n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class ReachReport:
    """What came of it."""

    request: ReachRequest
    model: ArmModel
    tally: Tally
    picture_problem: str | None
    """Why there is no picture although one was asked for."""


def reach(request: ReachRequest, progress: Progress) -> ReachReport:
    """Sample the workspace, and draw it if a picture is asked for.

    Raises:
        BadRequest: the request is wrong, or the picture cannot be written; nothing was written.
    """
    model = checked_model(request.model)
    check_seed(request.seed)
    if not 1 <= request.samples <= MOST_SAMPLES:
        raise BadRequest(f"samples: {request.samples} is not within 1 .. {MOST_SAMPLES}")
    try:
        if request.picture is not None:
            check_apart({"params": request.model.params, "picture": request.picture})
            check_output(request.picture, (".png",), "picture")
        samples, counted = sample(model, request.samples, request.seed, progress)
        problem = None
        if request.picture is not None:
            progress(1, 1, "drawing")
            problem = save_reach_figure(samples, counted, model, request.picture)
    except BadOutput as error:
        raise BadRequest(str(error)) from error
    return ReachReport(request, model, counted, problem)


def sample(model: ArmModel, count: int, seed: int, progress: Progress) -> tuple[ReachSamples, Tally]:
    """Random targets of the workspace with their answers, counted; the same for the same seed."""
    p_N_m, angles = random_targets(np.random.default_rng(seed), count)
    targets = Targets(p_R_from_N(p_N_m.T).T, approach_from(angles))
    valid, counted = [], Tally()
    for answers in model.in_parts(targets, progress):
        valid.append((answers.verdict == Verdict.VALID).sum(axis=0))
        counted += tally(answers)
    return ReachSamples(p_N_m, angles, np.concatenate(valid)), counted
