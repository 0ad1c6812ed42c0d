"""Command `diagnose`: checks a request, loads logs and campaign model, and diagnoses the case."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params, digest
from marsarm.common.effects import parse_effects
from marsarm.common.pool import select_runner
from marsarm.common.requests import load_fitting_params, select_arm
from marsarm.diagnosis.arm.arm_effects import effects_of_params
from marsarm.diagnosis.arm.audit import find_missing_motion, load_checked_recordings
from marsarm.diagnosis.arm.campaign_sensitivities import Logs
from marsarm.diagnosis.arm.case import CaseDiagnosis, diagnose_case, load_campaign_model
from marsarm.diagnosis.arm.logs import NotForDiagnosis, Recording
from marsarm.diagnosis.arm.record import HELD_OUT_FOLDER, PARAMS_FILE
from marsarm.diagnosis.arm.request import LogsRequest
from marsarm.diagnosis.arm.simulator import list_hypotheses
from sim.arm_model.load import ArmModel
from sim.effects.catalogue import catalogue
from sim.scenario.records import shorten
from simgap.common.errors import BadRequest
from simgap.common.files import cache_folder, file_sha256, json_sha256
from simgap.common.options import check_options
from simgap.common.progress import Progress, as_guess, no_progress, part_of
from simgap.files.columns import hint_at

CAMPAIGN_SHARE: Final = 0.9
"""Share of the campaign model in the time of a diagnosis, for the progress, if none is cached."""


def diagnose(request: LogsRequest, progress: Progress = no_progress) -> CaseDiagnosis:
    """Check a request, load its logs and the model of their campaign, and diagnose; write only the cache.

    Raises:
        BadRequest: The request is wrong, or a cached file cannot be read.
        NotForDiagnosis: The logs cannot be diagnosed; the message says what they lack.
        BadOutput: A cached file cannot be written.
    """
    check_options(request)
    logs, held_out = expand_logs(request.logs, "log"), expand_logs(request.held_out, "held-out log")
    arm = select_arm(request.arm, None).model
    base = _read_params(request, logs[0].parent, arm)
    if request.campaign is not None and not os.path.isdir(request.campaign):
        raise BadRequest(f"campaign {request.campaign}: there is no such folder of logs")
    kinds = None if request.catalogue is None else _parse_effects(request.catalogue)
    patch = parse_effects(request.effects, arm.params.tool_names)
    run, progress = select_runner(request.workers, request.cluster), as_guess(progress)
    progress(0.0, 0.0, "reading the logs")
    fitted = load_checked_recordings(logs, base, arm)
    params = base or fitted[0].params
    judged = load_checked_recordings(held_out, params, arm)
    _check_sessions((*logs, *held_out), fitted, judged)
    missing = find_missing_motion(fitted)
    if missing:
        raise NotForDiagnosis("\n".join(("too little motion for a diagnosis:", *missing)))
    sides = logs, held_out
    if request.campaign is not None:
        sides = _campaign_logs(request.campaign, fitted, judged)
    campaign = load_campaign_model(
        *sides,
        request.campaign or cache_folder("marsarm", "sensitivities"),
        run,
        part_of(progress, 0.0, CAMPAIGN_SHARE),
        kinds,
        request.arm,
    )
    progress(CAMPAIGN_SHARE, 1.0, "diagnosing")
    found = diagnose_case(
        fitted, judged, campaign, request.seed, (*effects_of_params(params, arm.params), *patch)
    )
    digests = {
        kind: json_sha256({"sha256": sorted(map(file_sha256, paths))})
        for kind, paths in (("logs", logs), ("held-out logs", held_out))
        if paths
    }
    return replace(found, params=params, digests=digests | {"parameters": digest(params)})


def _read_params(request: LogsRequest, folder: Path, arm: ArmModel) -> Params | None:
    """Return the given flight parameters, else those of the file in a folder; None if there is neither."""
    beside = folder / PARAMS_FILE
    path = request.params or (beside if beside.is_file() else None)
    return None if path is None else load_fitting_params(arm, path, request.mismatch)


def expand_logs(given: Sequence[Path], what: str) -> Logs:
    """Return files, and the logs inside folders sorted by name; BadRequest says what there is instead."""
    found: list[Path] = []
    for path in given:
        inside = [path]
        if os.path.isdir(path):  # unlike Path.is_dir, False for any bad name
            inside = sorted(one for one in path.glob("*.mcap") if one.is_file())
            if not inside:
                raise BadRequest(f"{what} {path}: this folder holds no .mcap file")
        elif not os.path.isfile(path):
            raise BadRequest(f"{what} {path}: there is no such log or folder")
        found += inside
    return tuple(found)


def _parse_effects(names: str) -> tuple[str, ...]:
    """Return the names in the order of the catalogue."""
    known = {one.effect for one in list_hypotheses(None)}
    wanted = {name.strip() for name in names.split(",")}
    problems = [
        f"catalogue: {shorten(name)!r} is no effect that a diagnosis can identify; "
        f"{hint_at(name, sorted(known), 'there are')}"
        for name in sorted(wanted - known)
    ]
    if problems:
        raise BadRequest("\n".join(problems))
    return tuple(name for name in catalogue() if name in wanted)


def _check_sessions(
    paths: Sequence[Path], fitted: Sequence[Recording], held_out: Sequence[Recording]
) -> None:
    """Refuse two logs of one session, whose name identifies features, and a held-out repeat of a motion."""
    known: dict[str, Path] = {}
    for path, one in zip(paths, (*fitted, *held_out), strict=True):
        if known.setdefault(one.name, path) is not path:
            raise NotForDiagnosis(
                f"log {path}: is session {one.name}, and so is {known[one.name]}; leave one of them out"
            )
    used = {one.block: one.name for one in fitted}
    for one in held_out:
        if one.block in used:
            raise NotForDiagnosis(
                f"held-out session {one.name} repeats the motion of {used[one.block]}, which is not held "
                "out; hold out both, or neither"
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
