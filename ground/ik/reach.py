"""What the arm reaches in its primary workspace: how many branches are valid, and why the others are out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from ground.common.files import BadOutput, check_output
from ground.common.progress import Progress
from ground.common.requests import BadRequest, check_apart, check_seed
from ground.ik.model import ArmModel, ModelRequest, checked_model
from ground.ik.reach_figure import save_reach_figure
from ground.ik.samples import sample
from ground.ik.tally import Tally

MOST_SAMPLES: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class ReachRequest:
    """What is asked."""

    model: ModelRequest = field(default_factory=ModelRequest)
    samples: int = 20_000
    seed: int = 0
    picture: Path | None = None


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
