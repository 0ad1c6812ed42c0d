"""Placement of an instrument on a surface: check the request, carry it out, report."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.params import Params
from fsw.dictionary.types import match_name, vector3
from marsarm.common.requests import (
    check_targets,
    fit_effects,
    format_numbers,
    make_world,
    parse_effects,
    select_arm,
)
from marsarm.runs.execution import (
    Execution,
    execute,
    execution_not_begun,
    initialise,
)
from marsarm.runs.request import PlaceRequest
from marsarm.telemetry.recorder import run_header
from sim.arms import BuiltArm, effects_of_run
from sim.effects.effect import Effect
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementResult, PlacementRun, preview_placement, unstow_duration_s
from sim.sequence import Outcome
from sim.setting import Surface, World
from sim.world import inside_rover
from simgap.common.errors import BadRequest
from simgap.common.files import check_unlocked
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress


@dataclass(frozen=True, slots=True)
class PlaceJob:
    """Checked request."""

    arm: BuiltArm
    world: World
    placement: Placement
    expected_s: float
    """Expected duration, for the progress bar."""
    effects: tuple[Effect, ...]


def prepare_placement(request: PlaceRequest) -> PlaceJob:
    """Check a request before anything moves, BadRequest if it is wrong or out of reach, and build its job."""
    check_options(request)
    point, normals = (np.array(vector, float)[:, None] for vector in (request.target_m, request.normal))
    what = "the direction out of the surface, such as 0 0 -1 for up"
    normal = vector3(check_targets(point, normals, ("target", "normal"), what)[:, 0])
    arm = select_arm(request.arm, request.params, request.mismatch)
    effects = parse_effects(request.effects, arm.params.tool_names)
    arm = fit_effects(arm, effects)
    tool = _parse_tool(request.tool or arm.model.description.instrument, arm.params)
    level = make_world("mars", request.tilt_roll_deg, request.tilt_pitch_deg)
    world = replace(level, surface=Surface(request.target_m, normal))
    if inside_rover(request.target_m, arm.model):
        raise BadRequest(
            f"target: {format_numbers(request.target_m)} m is inside the rover; {arm.model.workspace.hint}"
        )
    preview = preview_placement(arm, world, Placement(tool, request.target_m, normal), stowed=True)
    if preview.problem is not None:
        raise BadRequest(f"target: {format_numbers(request.target_m)} m cannot be reached: {preview.problem}")
    if not request.has_surface:
        world = level
    return PlaceJob(arm, world, preview.placement, preview.duration_s + unstow_duration_s(arm), effects)


def _parse_tool(name: str, params: Params) -> str:
    known = [tool for tool, switches in params.tool_switches.items() if switches]
    tool = match_name(name, known)
    if tool is None:
        raise BadRequest(
            f"tool: {name!r} cannot be placed; the tools with contact switches are {', '.join(known)}"
        )
    return tool


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """Placement that was carried out."""

    request: PlaceRequest
    tool: str
    """Tool that was placed."""
    execution: Execution[PlacementResult]


def place(request: PlaceRequest, progress: Progress = no_progress) -> PlaceReport:
    """Carry out a placement; BadRequest if the request is wrong; nothing moved and nothing was written."""
    job = prepare_placement(request)
    check_unlocked(request.files.log, "log")
    last = initialise(job.arm, request.seed, progress)
    if last.outcome is not Outcome.DONE:
        result = PlacementResult(last.outcome, None, last.duration_s, None, None, last.evrs)
        return PlaceReport(request, job.placement.tool, execution_not_begun(result, job.arm, request.files))
    stowed_rad = job.arm.params.poses.stowed_rad
    setup = Setup(job.arm, job.world, stowed_rad, request.seed, last.reference, effects_of_run(job.effects))
    loop = ClosedLoop(setup, with_truth=True)
    run = PlacementRun(loop, job.placement)
    header = run_header(
        loop, job.arm.name, request.seed, asdict(request), run.commands, job.effects, job.world
    )
    execution = execute(
        run,
        loop,
        header,
        request.files,
        job.world,
        progress,
        progress_at=lambda record: (record.tick / CYCLE_HZ, job.expected_s),
        is_for_picture=lambda record: CommandCompleted("GuardedMove") in record.outputs.evrs,
        arm=job.arm.model,
        title=f"{job.placement.tool} on arm {job.arm.name}",
    )
    return PlaceReport(request, job.placement.tool, execution)
