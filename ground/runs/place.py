"""The placement job: check the request, run it, keep the evidence."""

import time
from dataclasses import asdict, dataclass

from fsw.config import CYCLE_HZ, digest
from fsw.dictionary.evrs import CommandCompleted
from ground.common.progress import Progress
from ground.runs.artifacts import Frames, Kept, doing, keep, nothing_kept, open_log, recorded
from ground.runs.initialise import initialise
from ground.runs.place_request import PlaceRequest, checked
from ground.telemetry.header import run_header
from sim.arms import BuiltArm, effects_of_run
from sim.initialisation import InitialisationResult
from sim.loop import ClosedLoop, Setup
from sim.placement import PlacementResult, PlacementRun
from sim.sequence import Outcome


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """What came of it."""

    request: PlaceRequest
    params_sha256: str
    result: PlacementResult
    realtime_factor: float
    kept: Kept


def place(request: PlaceRequest, progress: Progress) -> PlaceReport:
    """Carry out a placement.

    Raises:
        BadRequest: the request is wrong; nothing moved and nothing was written.
    """
    job = checked(request)
    stops = initialise(job.arm, request.seed, progress)
    if stops[-1].outcome is not Outcome.DONE:
        return _not_initialised(request, job.arm, stops)
    stowed_rad = job.arm.params.poses.stowed_rad
    setup = Setup(
        job.arm, job.world, stowed_rad, request.seed, stops[-1].reference, effects_of_run(job.effects)
    )
    loop = ClosedLoop(setup, with_truth=request.files.log is not None)
    run = PlacementRun(loop, job.placement)
    header = run_header(loop, job.arm.name, request.seed, asdict(request), run.commands, job.effects)
    log = open_log(request.files.log, header, loop.config)
    frames = Frames()
    started = time.perf_counter()
    try:
        for record in recorded(run, log, request.files.when_disk_full):
            if frames.note(loop.plant, record):
                progress(record.tick / CYCLE_HZ, job.expected_s, doing(record))
            if CommandCompleted("GuardedMove") in record.outputs.evrs:
                frames.choose(loop.plant)
    finally:
        log.close()
    wall_s = time.perf_counter() - started
    if loop.failure is not None:
        raise loop.failure
    result = run.result()
    kept = keep(request.files, job.world, frames, loop.plant.data.qpos, log, progress)
    return PlaceReport(
        request=request,
        params_sha256=loop.config.params_sha256,
        result=result,
        realtime_factor=result.duration_s / wall_s,
        kept=kept,
    )


def _not_initialised(request: PlaceRequest, arm: BuiltArm, stops: list[InitialisationResult]) -> PlaceReport:
    failed = stops[-1]
    result = PlacementResult(failed.outcome, None, failed.duration_s, None, None, failed.evrs)
    kept = nothing_kept(request.files)
    return PlaceReport(request, digest(arm.params), result, 0.0, kept)
