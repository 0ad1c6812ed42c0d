"""Command `diagnose`: checks a request, loads logs and campaign model, and diagnoses the case."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from marsarm.common.effects import parse_effects
from marsarm.common.pool import Runner, select_runner
from marsarm.common.requests import load_fitting_params, select_arm
from marsarm.diagnosis.arm.arm_effects import effects_of_params
from marsarm.diagnosis.arm.audit import find_missing_motion, load_checked_recordings
from marsarm.diagnosis.arm.campaign_sensitivities import NOMINAL, Logs
from marsarm.diagnosis.arm.case import CaseDiagnosis, diagnose_case, load_campaign_model
from marsarm.diagnosis.arm.logs import NotForDiagnosis, Recording, load_recording
from marsarm.diagnosis.arm.record import HELD_OUT_FOLDER, PARAMS_FILE
from marsarm.diagnosis.arm.request import LogsRequest
from marsarm.diagnosis.arm.simulator import list_candidates
from sim.arm_model.load import ArmModel
from sim.arms import arm_named
from sim.effects.catalogue import catalogue, effect_name
from sim.effects.effect import Effect
from sim.scenario.records import shorten
from simgap.common.errors import BadRequest
from simgap.common.files import cache_folder, file_sha256
from simgap.common.options import check_options
from simgap.common.progress import Progress, as_guess, no_progress, part_of
from simgap.files.columns import hint_at

CAMPAIGN_SHARE: Final = 0.9
"""Share of the campaign model in the time of a diagnosis, for the progress, if none is cached."""


@dataclass(frozen=True, slots=True)
class DiagnoseJob:
    """Checked request for a diagnosis."""

    logs: tuple[Path, ...]
    held_out: tuple[Path, ...] = ()
    """Logs that take no part in fitting or selection."""
    base: Params | None = None
    """Flight parameters of the arm; None for those of the first log."""
    kinds: tuple[str, ...] | None = None
    """Names of the candidate effects; None for the whole catalogue."""
    campaign: Path | None = None
    """Folder of the campaign that the logs repeat, with its cache; None if the logs are their own
    campaign."""
    arm: str = NOMINAL
    """Name of an arm of their drawing."""
    seed: int = 0
    patch: tuple[Effect, ...] = ()
    """Effects that are switched on in the simulator from the start."""
    run: Runner = field(default_factory=lambda: select_runner(None, None), compare=False)
    """Runner of parallel jobs."""


def flight_params(job: DiagnoseJob) -> Params:
    """Return the flight parameters of the arm: those of the job, else of its first log."""
    return job.base or load_recording(job.logs[0], drawing(job)).params


def drawing(job: DiagnoseJob) -> ArmModel:
    """Return the drawing of the arm."""
    return arm_named(job.arm).model


def prepare_diagnosis(request: LogsRequest) -> DiagnoseJob:
    """Check all of a request that needs no log, list the logs of folders, and build the job.

    Raises:
        BadRequest: A file is missing or given twice, a name is unknown, or parameters are wrong.
    """
    check_options(request)
    fitted = tuple(_expand_logs(request.logs, "log"))
    held_out = tuple(_expand_logs(request.held_out, "held-out log"))
    _check_different(fitted, held_out)
    arm = select_arm(request.arm, None).model
    beside = fitted[0].parent / PARAMS_FILE
    path = request.params or (beside if beside.is_file() else None)
    base = None if path is None else load_fitting_params(arm, path, request.mismatch)
    if request.campaign is not None and not os.path.isdir(request.campaign):
        raise BadRequest(f"campaign {request.campaign}: there is no such folder of logs")
    kinds = None if request.catalogue is None else _parse_effects(request.catalogue)
    effects = parse_effects(request.effects, arm.params.tool_names)
    run = select_runner(request.workers, request.cluster)
    return DiagnoseJob(
        fitted, held_out, base, kinds, request.campaign, request.arm, request.seed, effects, run
    )


def _expand_logs(given: Sequence[Path], what: str) -> Iterator[Path]:
    """Yield files, and the logs inside folders sorted by name."""
    for path in given:
        if os.path.isdir(path):  # unlike Path.is_dir, False for any bad name
            inside = sorted(one for one in path.glob("*.mcap") if one.is_file())
            if not inside:
                raise BadRequest(f"{what} {path}: this folder holds no .mcap file")
            yield from inside
        elif os.path.isfile(path):
            yield path
        elif os.path.exists(path):
            raise BadRequest(f"{what} {path}: this is neither a regular file nor a folder")
        else:
            raise BadRequest(f"{what} {path}: there is no such file or folder")


def _check_different(fitted: tuple[Path, ...], held_out: tuple[Path, ...]) -> None:
    """Refuse logs with the same contents."""
    known: dict[str, Path] = {}
    for path in (*fitted, *held_out):
        try:
            same = known.setdefault(file_sha256(path), path)
        except OSError as error:
            raise BadRequest(f"log {path}: cannot be read ({error.strerror})") from error
        if same is path:
            continue
        if path in held_out and same in fitted:
            raise BadRequest(
                f"held-out log {path}: this is log {same} too; what is held out takes no part in fitting"
            )
        raise BadRequest(f"log {path}: is the same as {same}; give each once")


def _parse_effects(names: str) -> tuple[str, ...]:
    """Return the names in the order of the catalogue."""
    known = {effect_name(one.kind) for one in list_candidates(None)}
    wanted = {name.strip() for name in names.split(",")}
    problems = [
        f"catalogue: {shorten(name)!r} is no effect that a diagnosis can identify; "
        f"{hint_at(name, sorted(known), 'there are')}"
        for name in sorted(wanted - known)
    ]
    if problems:
        raise BadRequest("\n".join(problems))
    return tuple(name for name in catalogue() if name in wanted)


def diagnose(request: LogsRequest, progress: Progress = no_progress) -> CaseDiagnosis:
    """Check a request and diagnose its logs; write no file but the cache.

    Raises:
        BadRequest: The request is wrong, or a cached file cannot be read.
        NotForDiagnosis: The logs cannot be diagnosed; the message says what they lack.
        BadOutput: A cached file cannot be written.
    """
    return diagnose_logs(prepare_diagnosis(request), progress)


def diagnose_logs(job: DiagnoseJob, progress: Progress) -> CaseDiagnosis:
    """Diagnose the logs of a checked request.

    Raises:
        NotForDiagnosis: They cannot be diagnosed; the message says what they lack.
        BadRequest: A cached file of the campaign cannot be read.
        BadOutput: A cached file cannot be written.
    """
    arm, progress = drawing(job), as_guess(progress)
    progress(0.0, 0.0, "reading the logs")
    fitted = load_checked_recordings(job.logs, job.base, arm)
    base = job.base or fitted[0].params
    held_out_recordings = load_checked_recordings(job.held_out, base, arm)
    _check_sessions((*job.logs, *job.held_out), (*fitted, *held_out_recordings))
    _check_held_out(fitted, held_out_recordings)
    missing = find_missing_motion(fitted)
    if missing:
        raise NotForDiagnosis("\n".join(("too little motion for a diagnosis:", *missing)))
    logs, held_out = job.logs, job.held_out
    if job.campaign is not None:
        logs, held_out = _campaign_logs(job.campaign, fitted, held_out_recordings)
    campaign = load_campaign_model(
        logs,
        held_out,
        job.campaign or cache_folder("marsarm", "sensitivities"),
        job.run,
        part_of(progress, 0.0, CAMPAIGN_SHARE),
        job.kinds,
        job.arm,
    )
    progress(CAMPAIGN_SHARE, 1.0, "diagnosing")
    patch = (*effects_of_params(base, arm.params), *job.patch)
    return diagnose_case(fitted, held_out_recordings, campaign, job.seed, patch)


def _check_sessions(paths: Sequence[Path], recordings: Sequence[Recording]) -> None:
    """Refuse two logs of one session, as the session's name identifies features."""
    known: dict[str, Path] = {}
    for path, one in zip(paths, recordings, strict=True):
        if known.setdefault(one.name, path) is not path:
            raise NotForDiagnosis(
                f"log {path}: is session {one.name}, and so is {known[one.name]}; leave one of them out"
            )


def _check_held_out(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Refuse a held-out repeat of a fitted motion."""
    used = {one.block: one.name for one in fitted}
    both = [one for one in held_out if one.block in used]
    if both:
        raise NotForDiagnosis(
            f"held-out session {both[0].name} repeats the motion of {used[both[0].block]}, which is not "
            f"held out; hold out both, or neither"
        )


def _campaign_logs(
    folder: Path, fitted: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[Logs, Logs]:
    """Divide all logs of a campaign as the logs of the case are divided.

    A session that the case lacks stays on its side in the campaign, so the cache of the whole campaign
    serves.
    """
    inside = {path.stem: path for path in folder.glob("*.mcap")}
    outside = {path.stem: path for path in (folder / HELD_OUT_FOLDER).glob("*.mcap")}
    known = inside | outside
    sides = [{one.name for one in side} for side in (fitted, held_out)]
    missing = sorted((sides[0] | sides[1]) - known.keys())
    if missing:
        raise NotForDiagnosis(f"campaign {folder}: has no session {', '.join(missing)}")
    held_out_names = (outside.keys() - sides[0]) | sides[1]
    logs = tuple(known[name] for name in sorted(known.keys() - held_out_names))
    return logs, tuple(known[name] for name in sorted(held_out_names)) if held_out else ()
