"""The placement job: check the request, run it, keep the evidence."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Vector3
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.joints import SWITCHES_OF, Tool
from ground.report.picture import PictureError, PictureResult, check_path, save_movie, save_picture
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.record import Recorder
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.loop import ClosedLoop, Setup
from sim.params import BadParams, digest, params_over_nominal
from sim.placement import Placement, PlacementResult, PlacementRun
from sim.preview import preview, unstow_s
from sim.record import CycleRecord
from sim.world import GRAVITY_M_S2, MAX_TILT_RAD, Surface, World, build, inside_rover

FRAME_EVERY_S = 2.0
PICTURE_SIZE = (1280, 720)

Progress = Callable[[float, float, str], None]
"""Told what is done, what is to be done, and what it is."""


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
    scene: Literal["mars", "earth"] = "mars"
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


def place(request: PlaceRequest, progress: Progress) -> PlaceReport:
    """Carry out a placement.

    Raises:
        BadRequest: the request is wrong; nothing moved and nothing was written.
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


def _checked(request: PlaceRequest) -> _Job:
    """The job, after every check that can be made before anything moves or is written."""
    tool = _tool(request.tool)
    for name, values in (("target", request.target_m), ("normal", request.normal)):
        if not np.all(np.isfinite(values)):
            raise BadRequest(f"{name}: {_numbers(values)} is not three finite numbers")
    if np.linalg.norm(request.normal) < 1e-6:
        raise BadRequest(
            "normal: 0 0 0 has no direction; give the direction out of the surface, such as 0 0 -1 for up"
        )
    if request.scene not in GRAVITY_M_S2:
        raise BadRequest(f"scene: {request.scene!r} is not known; there are {', '.join(GRAVITY_M_S2)}")
    if request.seed < 0:
        raise BadRequest(f"seed: {request.seed} must not be negative")
    try:
        arm = arm_named(request.arm, None if request.params is None else params_over_nominal(request.params))
    except (UnknownArm, BadParams) as error:
        raise BadRequest(str(error)) from error
    world = _world(request)
    if inside_rover(request.target_m):
        raise BadRequest(
            f"target: {_numbers(request.target_m)} m is inside the rover; the workspace is around 2.1 0 -0.3"
        )
    _writable(request)
    seen = preview(arm, world, Placement(tool, request.target_m, request.normal))
    if seen.problem is not None:
        raise BadRequest(f"target: {_numbers(request.target_m)} m cannot be reached: {seen.problem}")
    if not request.has_surface:
        world = replace(world, surface=None)
    return _Job(arm, world, seen.placement, seen.duration_s + unstow_s(arm))


def _tool(name: str) -> Tool:
    known = {tool.name.lower(): tool for tool in Tool if SWITCHES_OF[tool]}
    if name.lower() not in known:
        raise BadRequest(
            f"tool: {name!r} cannot be placed; the tools with contact switches are {', '.join(known)}"
        )
    return known[name.lower()]


def _world(request: PlaceRequest) -> World:
    tilt_deg = (request.tilt_roll_deg, request.tilt_pitch_deg)
    if not np.all(np.isfinite(tilt_deg)):
        raise BadRequest(f"tilt: {_numbers(tilt_deg)} deg is not finite")
    roll, pitch = (float(np.radians(angle)) for angle in tilt_deg)
    world = World(request.scene, roll, pitch, Surface(request.target_m, request.normal))
    if max(abs(roll), abs(pitch), world.tilt_rad) > MAX_TILT_RAD + 1e-12:
        raise BadRequest(
            f"tilt: roll {request.tilt_roll_deg} and pitch {request.tilt_pitch_deg} deg tilt the rover by "
            f"{np.degrees(world.tilt_rad):.1f} deg; the arm is used up to {np.degrees(MAX_TILT_RAD):.0f} deg"
        )
    return world


def _writable(request: PlaceRequest) -> None:
    try:
        for path, suffix in ((request.picture, ".png"), (request.movie, ".gif")):
            if path is not None:
                check_path(path, suffix)
    except PictureError as error:
        raise BadRequest(str(error)) from error


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)


def _recorder(request: PlaceRequest, arm: BuiltArm) -> AbstractContextManager[Recorder | None]:
    if request.log is None:
        return nullcontext()
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
        picture = save_picture(model, data, "workspace", request.picture, PICTURE_SIZE)
    if request.movie is not None:

        def drawn() -> Iterator[NDArray[np.float64]]:
            for k, frame in enumerate(frames):
                progress(k, len(frames), "drawing")
                yield frame

        movie = save_movie(model, drawn(), "overview", request.movie)
    return picture, movie
