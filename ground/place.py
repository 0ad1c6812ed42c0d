"""The placement job: check the request, run it, keep the evidence."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Vector3
from fsw.dictionary.evrs import CommandCompleted, ContactMade
from fsw.dictionary.joints import Tool
from ground.report.picture import PictureResult, check_path, save_movie, save_picture
from ground.telemetry.record import Recorder
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.loop import ClosedLoop, Setup
from sim.params import BadParams, digest, params_over_nominal
from sim.placement import Placement, PlacementResult, PlacementRun
from sim.preview import preview
from sim.record import CycleRecord
from sim.world import MAX_TILT_RAD, ROVER_KEEP_OUT_N_M, Surface, World, tilt_rad

FRAME_EVERY_S = 2.0
PREVIEW_MARGIN_S = 400.0


class BadRequest(ValueError):
    """A request that cannot be carried out; nothing moved and nothing was written."""


@dataclass(frozen=True, slots=True)
class PlaceRequest:
    """What is asked; RNAV, metres, degrees."""

    tool: str = "apxs"
    target_m: Vector3 = (2.05, 0.1, -0.25)
    normal: Vector3 = (-0.5, 0.1, -0.85)
    tilt_roll_deg: float = 0.0
    tilt_pitch_deg: float = 0.0
    arm: str = "nominal"
    scene: str = "mars"
    seed: int = 0
    params: Path | None = None
    has_surface: bool = True
    log: Path | None = None
    picture: Path | None = None
    movie: Path | None = None


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """What came of it."""

    request: PlaceRequest
    params_sha256: str
    result: PlacementResult
    realtime_factor: float
    picture: PictureResult | None
    movie: PictureResult | None


@dataclass(frozen=True, slots=True)
class _Job:
    arm: BuiltArm
    world: World
    placement: Placement
    expected_s: float


def place(request: PlaceRequest, progress: Callable[[float, float, str], None] = lambda done, total, what: None) -> PlaceReport:
    """Carry out a placement.

    `progress` is told seconds done, seconds expected and what is being done.

    Raises:
        BadRequest: the request is wrong; nothing moved and nothing was written.
        LogNotWritable: likewise.
        PictureError: likewise.
    """
    job = _checked(request)
    setup = Setup(job.arm, job.world, job.arm.params.poses.stowed_rad, request.seed)
    loop = ClosedLoop(setup, with_truth=request.log is not None)
    run = PlacementRun(loop, job.placement)
    frames: list[NDArray[np.float64]] = []
    best = loop.plant.data.qpos.copy()
    started = time.perf_counter()
    with _recorder(request, job.arm) as recorder:
        for record in run:
            if recorder is not None:
                recorder.write(record)
            if record.tick % round(FRAME_EVERY_S * CYCLE_HZ) == 0:
                frames.append(loop.plant.data.qpos.copy())
                progress(record.tick / CYCLE_HZ, job.expected_s, _doing(record))
            if _worth_a_picture(record):
                best = loop.plant.data.qpos.copy()
    wall_s = time.perf_counter() - started
    if loop.failure is not None:
        raise loop.failure
    result = run.result()
    if result.contact is None:
        best = loop.plant.data.qpos.copy()
    picture, movie = _pictures(request, job.world, best, frames, progress)
    return PlaceReport(request, loop.config.params_sha256, result, result.duration_s / wall_s, picture, movie)


def _worth_a_picture(record: CycleRecord) -> bool:
    return CommandCompleted("GuardedMove") in record.outputs.evrs


def _doing(record: CycleRecord) -> str:
    return record.outputs.joint.mode.name.lower().replace("_", " ")
