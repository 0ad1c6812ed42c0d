"""Hardstop initialisation of one joint or of all."""

from dataclasses import dataclass
from typing import Final

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import CalibrateAll
from fsw.dictionary.enums import Joint
from fsw.executive.poses import homing_start_poses
from marsarm.common.effects import fit_effects, parse_effects
from marsarm.common.requests import make_world, select_arm
from marsarm.runs.request import HardstopRequest
from sim.arm_check import NoPlan, without_turret
from sim.arms import BuiltArm, effects_of_run
from sim.effects.effect import Effect
from sim.effects.environment import default_ambient
from sim.initialisation import InitialisationResult, InitialisationRun, prepare_homing
from sim.loop import ClosedLoop, Setup
from sim.setting import WARM_C, World
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress

COLDEST_C, WARMEST_C = -130.0, 50.0
EXPECTED_S: Final = 1030.0
"""Approximate duration of the initialisation of all joints, for the progress bar."""


@dataclass(frozen=True, slots=True, eq=False)
class HardstopReport:
    """Run of a request."""

    request: HardstopRequest
    result: InitialisationResult
    poses_rad: tuple[tuple[float, ...], ...]
    """Pose in which each joint runs to its hardstop, in the order of Joint; its own angle is the first."""


@dataclass(frozen=True, slots=True, eq=False)
class HardstopJob:
    """Checked request."""

    joint: Joint | None
    """Joint that finds its hardstop; None for all."""
    arm: BuiltArm
    world: World
    effects: tuple[Effect, ...]


def hardstop(request: HardstopRequest, progress: Progress = no_progress) -> HardstopReport:
    """Find hardstops; BadRequest if the request is wrong; nothing moved and nothing was written."""
    job = prepare_hardstop(request)
    result = _run_homing(request, job, progress)
    poses = tuple(tuple(homing_start_poses(job.arm.params, joint)[-1]) for joint in Joint)
    return HardstopReport(request, result, poses)


def prepare_hardstop(request: HardstopRequest) -> HardstopJob:
    """Check a request before anything moves or is written, BadRequest if it is wrong, and build its job."""
    check_options(request)
    temperature_C = WARM_C if request.temperature_C is None else request.temperature_C
    if not COLDEST_C <= temperature_C <= WARMEST_C:
        raise BadRequest(
            f"temperature: {temperature_C} degC is not within {COLDEST_C:g} .. {WARMEST_C:g} degC"
        )
    world = make_world(request.scene, request.tilt_roll_deg, request.tilt_pitch_deg)
    arm = select_arm(request.arm, request.params, request.mismatch)
    effects = parse_effects(request.effects, arm.params.tool_names)
    arm = fit_effects(arm, effects)
    return HardstopJob(
        joint=None if request.joint is None else _parse_joint(request.joint),
        arm=arm if request.turret else _remove_turret(arm, request),
        world=world,
        effects=(*default_ambient(effects, temperature_C), *effects_of_run(effects)),
    )


def _parse_joint(name: str) -> Joint:
    known = {joint.name.lower(): joint for joint in Joint}
    if name.lower() not in known:
        raise BadRequest(f"joint: {name!r} is not known; there are {', '.join(known)}")
    return known[name.lower()]


def _remove_turret(arm: BuiltArm, request: HardstopRequest) -> BuiltArm:
    try:
        return without_turret(arm, on_earth=request.scene == "earth")
    except NoPlan as error:
        raise BadRequest(f"hardstop: no poses for Earth without a turret: {error}") from error


def _run_homing(request: HardstopRequest, job: HardstopJob, progress: Progress) -> InitialisationResult:
    run = _prepare_run(request, job)
    loop = run.loop
    if job.joint is not None:
        progress(0, 1, job.joint.name.lower())
    for record in run:
        if job.joint is None and record.tick % CYCLE_HZ == 0:
            homing = loop.state.move.homing if loop.state.move is not None else None
            activity = "moving" if homing is None else homing.joint.name.lower()
            progress(record.tick / CYCLE_HZ, EXPECTED_S, activity)
    if loop.failure is not None:
        raise loop.failure
    return run.result()


def _prepare_run(request: HardstopRequest, job: HardstopJob) -> InitialisationRun:
    if job.joint is not None:
        return prepare_homing(job.arm, job.joint, job.world, request.seed, job.effects)
    start_rad = job.arm.params.hardstop.start_rad
    setup = Setup(job.arm, job.world, start_rad, request.seed, effects=job.effects)
    return InitialisationRun(ClosedLoop(setup), CalibrateAll())
