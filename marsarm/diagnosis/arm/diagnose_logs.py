"""Command `diagnose`: checks a request, loads logs and campaign model, diagnoses the case, and writes files.

Files are the report page, a patch of effects, and new flight parameters.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from fsw.dictionary.params import Params, digest
from marsarm.common.pool import select_runner
from marsarm.common.requests import load_fitting_params, parse_effects, select_arm
from marsarm.diagnosis.arm.arm_effects import effects_of_params, list_hypotheses
from marsarm.diagnosis.arm.audit import find_missing_motion, load_checked_recordings
from marsarm.diagnosis.arm.campaign_sensitivities import Logs, digest_logs
from marsarm.diagnosis.arm.case import CaseDiagnosis, diagnose_case, load_campaign_model
from marsarm.diagnosis.arm.logs import NotForDiagnosis, Recording
from marsarm.diagnosis.arm.record import HELD_OUT_FOLDER, PARAMS_FILE
from marsarm.diagnosis.arm.request import DiagnoseRequest, LogsRequest
from marsarm.diagnosis.problem import Hypothesis
from sim.arm_model.load import ArmModel
from sim.effects.catalogue import catalogue, effect_name, has_flight_parameter
from sim.effects.effect import Effect, params_with_effects
from sim.params import BadParams, check_params, params_toml
from sim.scenario.effects import effect_file_text, effect_text
from sim.scenario.records import shorten
from simgap import Diagnosis, to_document
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write, cache_folder, check_distinct_files, json_sha256
from simgap.common.options import check_options, command_text
from simgap.common.page import Origin
from simgap.common.progress import Progress, as_guess, no_progress, part_of
from simgap.common.report import file_lines
from simgap.files.columns import hint_at
from simgap.report.details import finding_sentences
from simgap.report.page import save_diagnosis_page

CAMPAIGN_SHARE: Final = 0.9
"""Share of the campaign model in the time of a diagnosis, for the progress, if none is cached."""


def diagnose(request: LogsRequest, progress: Progress = no_progress) -> CaseDiagnosis:
    """Check a request, load its logs and the model of their campaign, and diagnose; write only the cache.

    BadRequest if the request is wrong or a cached file cannot be read, NotForDiagnosis if the logs lack what
    a diagnosis needs, BadOutput if a cached file cannot be written.
    """
    check_options(request)
    logs, held_out = expand_logs(request.logs, "log"), expand_logs(request.held_out, "held-out log")
    arm = _select_drawing(request.arm)
    written = {name: getattr(request, name, None) for name in ("patch", "new_params", "out")}
    check_distinct_files({"flight parameters of these logs": logs[0].parent / PARAMS_FILE, **written})
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
    digests = {
        kind: json_sha256({"sha256": sorted(digest_logs(paths))})
        for kind, paths in (("logs", logs), ("held-out logs", held_out))
        if paths
    }
    _check_sessions((*logs, *held_out), fitted, judged)
    missing = find_missing_motion(fitted)
    if missing:
        raise NotForDiagnosis("\n".join(("too little motion for a diagnosis:", *missing)))
    sides, kept_in = (logs, held_out), request.campaign or cache_folder("marsarm", "sensitivities")
    if request.campaign is not None:
        sides = _campaign_logs(request.campaign, fitted, judged)
    computing = part_of(progress, 0.0, CAMPAIGN_SHARE)
    campaign = load_campaign_model(*sides, kept_in, run, computing, kinds, request.arm)
    progress(CAMPAIGN_SHARE, 1.0, "diagnosing")
    known = (*effects_of_params(params, arm.params), *patch)
    found = diagnose_case(fitted, judged, campaign, request.seed, known)
    return replace(found, params=params, digests=digests | {"parameters": digest(params)})


def _select_drawing(name: str) -> ArmModel:
    """Return the drawing of this name; BadRequest if the name is that of one arm with its errors."""
    built = select_arm(name, None)
    if built.effects:
        raise BadRequest(
            f"arm {shorten(name)}: logs are compared with a drawing, not with one arm; give the name of the "
            "drawing, and what is known of the arm as --params or --effect"
        )
    return built.model


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
            is_other = os.path.exists(path)
            why = "is not a regular file; give a log or a folder" if is_other else "no such log or folder"
            raise BadRequest(f"{what} {path}: {why}")
        found += inside
    return tuple(found)


def _parse_effects(names: str) -> tuple[str, ...]:
    """Return the names in the order of the catalogue."""
    known = {one.name for one in list_hypotheses()}
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
    """Return all logs of a campaign that are fitted, and those held out if the case has any.

    NotForDiagnosis if it lacks a session of the case.
    """
    sides = [tuple(sorted(one.glob("*.mcap"))) for one in (folder, folder / HELD_OUT_FOLDER)]
    for side, given, where in zip(sides, (fitted, held_out), ("", " that is held out"), strict=True):
        missing = sorted({one.name for one in given} - {path.stem for path in side})
        if missing:
            raise NotForDiagnosis(f"campaign {folder}: has no session{where} {', '.join(missing)}")
    return sides[0], sides[1] if held_out else ()


class NothingToWrite(Exception):
    """No content for a file; the message says why."""


def effects_of_findings(diagnosis: Diagnosis) -> tuple[Effect, ...]:
    """Return the effects of a diagnosis with their fitted values; NothingToWrite if there is none."""
    if not diagnosis.findings:
        raise NothingToWrite("no effect was found, so there is none to switch on")
    pairs = zip(diagnosis.effects, diagnosis.sizes, strict=True)
    return tuple(one.switch_on(np.array(size)) for one, size in pairs if isinstance(one, Hypothesis))


def patch_text(diagnosis: Diagnosis) -> str:
    """Return the file that switches on the findings, for --effect and for a scenario.

    NothingToWrite if no effect was found.
    """
    comments = [
        "Findings of a diagnosis; switch them on with --effect and the name of this file.",
        *finding_sentences(diagnosis.findings),
    ]
    return effect_file_text(effects_of_findings(diagnosis), comments)


def params_text(diagnosis: Diagnosis, base: Params, drawing: Params) -> str:
    """Return the parameter file for --params: all values of `base` and the findings that are not nominal.

    NothingToWrite if there is no parameter for any effect, or flight software refuses the values.
    """
    effects = effects_of_findings(diagnosis)
    params, texts = params_with_effects(effects, base), [effect_text(effect) for effect in effects]
    if params == base:
        raise NothingToWrite(f"there is no flight parameter for {', '.join(texts)}")
    try:
        check_params(params, "flight software would not take them")
    except BadParams as error:
        raise NothingToWrite(str(error)) from error
    kinds = [type(effect) for effect in effects]
    unknown = [effect_name(kind) for kind in kinds if not has_flight_parameter(kind)]
    comments = [
        "Flight parameters with the findings of a diagnosis; all others are nominal.",
        *(f"Effect: {text}" for text in texts),
        *(f"There is no flight parameter for {name}." for name in unknown),
    ]
    return params_toml(drawing, params, comments)


def save_diagnosis_files(result: CaseDiagnosis, request: DiagnoseRequest) -> tuple[str, ...]:
    """Write the files of a request; return a line about each, and a reason if it has no content.

    BadOutput if a file cannot be written.
    """
    diagnosis, base, drawing = result.diagnosis, result.params, select_arm(request.arm, None).model.params
    lines: list[str] = []
    if request.report is not None:
        digests = {**result.digests, "result": json_sha256(to_document(diagnosis))}
        origin = Origin(command_text("marsarm diagnose", request), digests)
        save_diagnosis_page(diagnosis, result.traces, request.report, origin)
        lines += file_lines({"report": request.report})
    for what, path in (("patch", request.patch), ("new-params", request.new_params)):
        if path is None:
            continue
        try:
            is_patch = what == "patch"
            text = patch_text(diagnosis) if is_patch else params_text(diagnosis, base or drawing, drawing)
        except NothingToWrite as why:
            lines.append(f"{what} {path}: not written: {why}")
            continue
        with atomic_write(path, what) as file:
            file.write(text.encode())
        lines += file_lines({what: path})
    return tuple(lines)
