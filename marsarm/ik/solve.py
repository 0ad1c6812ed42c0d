"""Inverse kinematics of one target, or of a file of targets, as a request of the command line."""

from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from fsw.kinematics.ik import IkResult
from fsw.kinematics.transforms import select_targets
from marsarm.common.pool import select_runner
from marsarm.ik.model import IkModel, build_ik_model
from marsarm.ik.request import IkRequest
from marsarm.ik.tally import Tally, tally
from marsarm.ik.targets import IkTargets, make_targets, read_targets
from marsarm.ik.writers import open_writer
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress


@dataclass(frozen=True, slots=True, eq=False)
class IkReport:
    """Result for one target."""

    request: IkRequest
    model: IkModel
    result: IkResult
    """Result of every branch, shape (8,)."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchReport:
    """Summary of a batch; the file `request.out` holds the results."""

    request: IkRequest
    model: IkModel
    tally: Tally


def solve(request: IkRequest, progress: Progress = no_progress) -> IkReport | BatchReport:
    """Solve the inverse kinematics of a request.

    Raises:
        BadRequest: The request is wrong, or a file cannot be read or written; nothing was written.
    """
    check_options(request)
    model = build_ik_model(request.model)
    if request.batch is None and request.out is None:
        return IkReport(request, model, select_targets(model.solve(_one_target(request)), 0))
    if request.batch is None or request.out is None:
        raise BadRequest("batch and out: give both, a file with targets and a file for the results")
    if request.position_m is not None or request.approach is not None:
        raise BadRequest("position and approach: the targets are in the batch; give one or the other")
    return _solve_batch(request, model, request.batch, request.out, progress)


def _one_target(request: IkRequest) -> IkTargets:
    if request.position_m is None or request.approach is None:
        raise BadRequest(
            "position and approach: give both, such as --position 2.1 0 -0.3 --approach 0.5 0 0.85; "
            "or a batch and out"
        )
    position, approach = (np.array(vector)[:, None] for vector in (request.position_m, request.approach))
    return make_targets(position, approach, request.frame, lambda _: ("position", "approach"))


def _solve_batch(
    request: IkRequest, model: IkModel, batch: Path, out: Path, progress: Progress
) -> BatchReport:
    targets = read_targets(batch, request.frame)
    run = select_runner(request.workers, request.cluster)
    counted = Tally()
    with open_writer(out, _about(request, model)) as writer:
        for result in model.solve_in_batches(targets, run, progress):
            writer.add(result)
            counted += tally(result)
        progress(1, 1, "writing")
    return BatchReport(request, model, counted)


def _about(request: IkRequest, model: IkModel) -> dict[str, object]:
    """Describe how the file was made, so that it can be made again."""
    params = request.model.params
    return {
        "marsarm": version("marsarm"),
        **asdict(request.model),
        "params": None if params is None else str(params),
        "params_sha256": model.params_sha256,
        "gravity_R_m_s2": None if model.gravity_R_m_s2 is None else model.gravity_R_m_s2.tolist(),
        "batch": str(request.batch),
        "frame": request.frame,
        "excess": "radians beyond the limit of the joint, or metres out of reach",
        "forward_error": "the larger of position error [m] and axis error [rad], by forward kinematics",
    }
