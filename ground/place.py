"""The placement job: check the request, run it, keep the evidence."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ, digest
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.joints import STOP_ORDER
from ground.place_request import PlaceRequest, checked
from ground.report.picture import PictureResult, save_movie, save_picture
from ground.request import BadRequest
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.record import Recorder
from sim.arms import BuiltArm
from sim.initialisation import Initialisation, initialised
from sim.loop import ClosedLoop, Setup
from sim.placement import PlacementResult, PlacementRun
from sim.record import CycleRecord
from sim.sequence import Outcome
from sim.world import World, build

FRAME_EVERY_S = 3.0
PICTURE_SIZE = (1280, 720)
MOVIE_SHADOWS = 1024
"""Pixels across a shadow map: coarser than for a picture, and several times faster."""

Progress = Callable[[float, float, str], None]
"""Told what is done, what is to be done, and what it is."""


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """What came of it."""

    request: PlaceRequest
    params_sha256: str
    result: PlacementResult
    realtime_factor: float
    picture: PictureResult | None
    movie: PictureResult | None
    log_problem: str | None
    """From when on the log could not be written, and why; the run went on."""


def place(request: PlaceRequest, progress: Progress) -> PlaceReport:
    """Carry out a placement.

    Raises:
        BadRequest: the request is wrong; nothing moved and nothing was written.
    """
    job = checked(request)
    stops = _initialised(job.arm, request.seed, progress)
    if stops[-1].outcome is not Outcome.DONE:
        return _not_initialised(request, job.arm, stops)
    setup = Setup(job.arm, job.world, job.arm.params.poses.stowed_rad, request.seed, stops[-1].reference)
    loop = ClosedLoop(setup, with_truth=request.log is not None)
    run = PlacementRun(loop, job.placement)
    log = _Log(request.log, _recorder(request, job.arm))
    frames: list[NDArray[np.float64]] = []
    best = None
    started = time.perf_counter()
    try:
        for record in run:
            log.write(record)
            if record.tick % round(FRAME_EVERY_S * CYCLE_HZ) == 0:
                frames.append(loop.plant.data.qpos.copy())
                progress(record.tick / CYCLE_HZ, job.expected_s, _doing(record))
            if CommandCompleted("GuardedMove") in record.outputs.evrs:
                best = loop.plant.data.qpos.copy()
    finally:
        log.close()
    wall_s = time.perf_counter() - started
    if loop.failure is not None:
        raise loop.failure
    result = run.result()
    shown = loop.plant.data.qpos.copy() if best is None else best
    picture, movie = _pictures(request, job.world, shown, frames, progress)
    return PlaceReport(
        request=request,
        params_sha256=loop.config.params_sha256,
        result=result,
        realtime_factor=result.duration_s / wall_s,
        picture=picture,
        movie=movie,
        log_problem=log.problem,
    )


def _initialised(arm: BuiltArm, seed: int, progress: Progress) -> list[Initialisation]:
    """Every joint at its hardstop, as was done before the arm was stowed."""
    stops: list[Initialisation] = []
    for run in initialised(arm, seed=seed):
        if run.failure is not None:
            raise run.failure
        stops.append(run)
        progress(len(stops), len(STOP_ORDER), "initialising")
    return stops


def _not_initialised(request: PlaceRequest, arm: BuiltArm, stops: list[Initialisation]) -> PlaceReport:
    failed = stops[-1]
    result = PlacementResult(failed.outcome, None, failed.duration_s, None, None, failed.evrs)
    no_log = None if request.log is None else f"log {request.log}: not recorded (the arm was not initialised)"
    return PlaceReport(request, digest(arm.params), result, 0.0, None, None, no_log)


class _Log:
    """A recorder whose disk may fill up: the run goes on, and the report says what was not recorded."""

    def __init__(self, path: Path | None, recorder: Recorder | None):
        self._path = path
        self._recorder = recorder
        self.problem: str | None = None

    def write(self, record: CycleRecord) -> None:
        if self._recorder is None or self.problem is not None:
            return
        try:
            self._recorder.write(record)
        except OSError as error:
            self._failed(error, f"from {record.tick / CYCLE_HZ:.2f} s on")

    def close(self) -> None:
        if self._recorder is None:
            return
        try:
            self._recorder.close()
        except OSError as error:
            if self.problem is None:
                self._failed(error, "at the end")

    def _failed(self, error: OSError, when: str) -> None:
        why = error.strerror or str(error)
        self.problem = f"log {self._path}: not recorded {when} ({why}); what was closed before can be read"


def _doing(record: CycleRecord) -> str:
    return record.outputs.joint.mode.name.lower().replace("_", " ")


def _recorder(request: PlaceRequest, arm: BuiltArm) -> Recorder | None:
    if request.log is None:
        return None
    header = {
        "marsarm": version("marsarm"),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "params_sha256": digest(arm.params),
        "arm": arm.name,
        "seed": str(request.seed),
        "request": json.dumps(asdict(request), default=str, sort_keys=True),
    }
    try:
        return Recorder(request.log, header)
    except LogNotWritable as error:
        raise BadRequest(str(error)) from error


def _pictures(
    request: PlaceRequest,
    world: World,
    best: NDArray[np.float64],
    frames: list[NDArray[np.float64]],
    progress: Progress,
) -> tuple[PictureResult | None, PictureResult | None]:
    """The picture at contact and the movie of the run, from the model with everything that only looks."""
    if request.picture is None and request.movie is None:
        return None, None
    model = build(world, for_pictures=True).compile()
    picture = movie = None
    if request.picture is not None:
        data = mujoco.MjData(model)
        data.qpos[:] = best
        mujoco.mj_forward(model, data)
        camera = "workspace" if world.surface is None else "target"
        picture = save_picture(model, data, camera, request.picture, PICTURE_SIZE)
    if request.movie is not None:

        def drawn() -> Iterator[NDArray[np.float64]]:
            for k, frame in enumerate(frames):
                progress(k, len(frames), "drawing")
                yield frame

        model.vis.quality.shadowsize = MOVIE_SHADOWS
        movie = save_movie(model, drawn(), "overview", request.movie)
    return picture, movie
