"""A diagnosis by logs or by poses: read robot and data, find the effects, print them and write the files."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from simgap.catalogue.own_effects import load_effects
from simgap.checks.audit import audit
from simgap.command.request import FIT_SHARE, CompareRequest, DiagnoseRequest
from simgap.common.errors import BadOutput, BadRequest, RobotError
from simgap.common.files import (
    atomic_write,
    cache_folder,
    check_distinct_files,
    check_new_path,
    digest_files,
    json_sha256,
)
from simgap.common.interruption import Interrupted
from simgap.common.options import check_options, command_text
from simgap.common.page import Origin
from simgap.common.progress import GUESS, Progress, no_progress
from simgap.common.report import ReportTable, file_lines, to_json
from simgap.compare import compare
from simgap.diagnosis import check_audit, diagnose, end_sentence
from simgap.files.robot_file import SerialFile, read_robot_file
from simgap.loading import load
from simgap.patch.patch import MODEL_FILE, RUNTIME_FILE, Patch, make_patch, write_patch
from simgap.patch.text import FOUND_FILE, read_found
from simgap.report.details import detail_lines
from simgap.report.document import to_document
from simgap.report.page import save_diagnosis_page
from simgap.report.sentences import verdict_lines
from simgap.report.traces import Trace, convert_trace, trace_motions
from simgap.result import Comparison, Diagnosis
from simgap.robot import Robot
from simgap.serial_arm.calibrate import JointTerms, held_out_ratio, joint_errors
from simgap.serial_arm.effects import patch_arm
from simgap.serial_arm.files import arm_to_toml, read_arm, read_series
from simgap.serial_arm.fit import assess_identifiability
from simgap.serial_arm.model import GEOMETRY, TERMS, SerialArm
from simgap.serial_arm.nested_models import NestedModel
from simgap.serial_arm.tracker import TrackerFit, describe_tracker, fit_tracker


def parse_terms(text: str) -> tuple[str, ...]:
    """Return the terms that a text names, in the order of TERMS; BadRequest if a word is not known."""
    if text in ("all", "none"):
        return TERMS if text == "all" else ()
    words = [word.strip() for word in text.split(",")]
    wrong = next((word for word in words if word not in TERMS), None)
    if wrong in ("all", "none"):
        raise BadRequest(f"terms: {text!r}: all and none stand alone")
    if wrong is not None:
        raise BadRequest(f"terms: {wrong!r:.60} is not known; there are {', '.join(TERMS)}, all and none")
    return tuple(term for term in TERMS if term in words)


def calibration_json(fitted: TrackerFit) -> dict[str, Any]:
    """Convert a calibration to a JSON document in metres and radians."""
    last, fit, test = fitted.models[-1], fitted.found.fit, fitted.temperature
    seen = assess_identifiability(fit.parameters, fit.at, fit.used)
    return {
        "fitted_poses": fitted.found.model.series.count,
        "terms": list(last.terms),
        "models": [_model_json(one) for one in fitted.models],
        "held_out_rms_m": last.fresh.rms_m,
        "held_out_rms_rad": last.fresh.rms_rad,
        "held_out_over_expected": held_out_ratio(fitted.found, fitted.fresh),
        "fit": {
            "parameters": len(fit.parameters),
            "rank": seen.rank,
            "condition": seen.condition if seen.rank else None,
            "converged": fit.converged,
            "iterations": fit.iterations,
            "sigma0": fit.sigma0,
            "outlier_rows": list(fitted.found.outliers),
            "unidentifiable": to_json(seen.unidentifiable_groups()),
        },
        "joints": to_json(joint_errors(fitted.found)),
        "temperature": None
        if test is None
        else to_json(test) | {"explains": "something" if test.explains else "nothing"},
    }


def _model_json(model: NestedModel) -> dict[str, Any]:
    is_first = model.gain_sigma_m == 0.0
    return {
        "terms": list(model.terms),
        "fitted_rms_m": model.fitted.rms_m,
        "cross_validated_rms_m": model.held_out.rms_m,
        "gain_m": None if is_first else model.gain_m,
        "gain_sigma_m": None if is_first else model.gain_sigma_m,
        "significant": model.is_significant,
        "held_out_rms_m": model.fresh.rms_m,
        "held_out_max_m": float(model.fresh.position_m.max()),
        "held_out_rms_rad": model.fresh.rms_rad,
    }


def calibration_parts(fitted: TrackerFit) -> list[str | ReportTable]:
    """Show the gain of each term, the errors of the joints, and the noise."""
    rows = []
    for k, one in enumerate(fitted.models):
        gain = [one.gain_m, one.gain_sigma_m] if k else [None, None]
        lengths_m = [one.fitted.rms_m, one.held_out.rms_m, *gain, one.fresh.rms_m, one.fresh.position_m.max()]
        cells = ("" if length is None else f"{length * 1e3:.3f}" for length in lengths_m)
        rows.append((f"+ {one.terms[-1]}" if k else "base, target", *cells))
    poses = f"{fitted.found.model.series.count} poses fitted, {fitted.fresh.count} held out"
    head = ("with", "fitted", "validated", "less by", "+-", "held out", "largest")
    parts: list[str | ReportTable] = [ReportTable(head, rows, f"Position error, rms [mm]; {poses}")]
    if set(fitted.models[-1].terms) - {GEOMETRY}:
        head = ("joint", "compliance", "+-", "hysteresis", "+-", "periodic", "largest")
        rows = [_joint_cells(one) for one in joint_errors(fitted.found)]
        parts.append(ReportTable(head, rows, "Joint errors: urad/Nm, urad, mrad, mrad"))
    fit = fitted.found.fit
    return [*parts, f"{len(fit.parameters)} parameters; noise is {fit.sigma0:.2f} of what the file says"]


def _joint_cells(one: JointTerms) -> tuple[str, ...]:
    micro = (one.compliance_rad_per_Nm, one.compliance_sigma, one.hysteresis_rad, one.hysteresis_sigma)
    milli = (one.periodic_rms_rad, one.periodic_peak_rad)
    return one.name, *(f"{1e6 * value:.1f}" for value in micro), *(f"{1e3 * value:.2f}" for value in milli)


GOES_ON: Final = "the same command goes on after its last complete step"
"""Sentence about an interruption."""
ARM_FILE: Final = "arm.toml"
"""File of a serial arm with its links and what was named, in the folder of a patch."""
CALIBRATED_FILE: Final = "calibrated.toml"
"""File of a serial arm with every term that was fitted, named or not."""


@dataclass(frozen=True, slots=True)
class RobotDiagnosis:
    """A diagnosis with what its files need."""

    request: DiagnoseRequest
    diagnosis: Diagnosis
    traces: tuple[Trace, ...]
    """Of held-out motions, or of the fitted ones if none is held out; empty without a report."""
    patch: Patch | SerialArm | None
    digests: dict[str, str]
    """SHA-256 of the files that were read."""
    fitted: TrackerFit | None = None
    """Calibration by poses; None for logs."""


def diagnose_robot(request: DiagnoseRequest, progress: Progress = no_progress) -> RobotDiagnosis:
    """Diagnose a robot, writing in the cache alone; BadRequest or RobotError if anything given is wrong."""
    check_options(request)
    if request.split and request.held_out:
        raise BadRequest("split, held-out: they exclude each other; give one of the two")
    check_distinct_files({"report": request.report, "patch": request.patch})
    terms = parse_terms(request.terms)
    _check_folder(request.patch)
    progress(0.0, 0.0, "reading")
    file = read_robot_file(request.robot)
    if isinstance(file, SerialFile):
        return _diagnose_tracker(request, file, terms, progress)
    given = {
        f"terms {request.terms}": request.terms not in ("all", "none"),
        "fit-share": request.fit_share != FIT_SHARE,
        "nested": request.nested,
    }
    _refuse_any(given, "is for poses of a tracker; this robot file has a model and logs")
    if request.terms == "none" and request.effects:
        raise BadRequest("effects: none is looked for with terms none; leave one of the two away")
    return _diagnose_logs(request, progress)


def _refuse_any(given: dict[str, bool], why: str) -> None:
    wrong = next((name for name, is_given in given.items() if is_given), None)
    if wrong:
        raise BadRequest(f"{wrong}: {why}")


def _diagnose_logs(request: DiagnoseRequest, progress: Progress) -> RobotDiagnosis:
    robot = Robot.from_toml(request.robot)
    if request.patch is not None and robot.file is not None:
        model = robot.path.parent / robot.file.model
        check_distinct_files({"model": model, "patch": request.patch / MODEL_FILE})
    logs = load(robot, request.logs, split=request.split, held_out=request.held_out)
    effects = [one for path in request.effects for one in load_effects(path, robot, logs)]
    start = {} if request.start is None else read_found(robot, request.start)
    files = {"robot": [request.robot], "log": request.logs, "effects": request.effects}
    if request.start is not None:
        files["start"] = [request.start / FOUND_FILE]
    digests = digest_files(files)
    progress(0.0, 0.0, "auditing")
    found = audit(robot, logs)
    progress(0.0, 0.0, "preparing the fit")
    try:
        result = diagnose(
            robot,
            logs.fit,
            held_out=logs.judged,
            effects=effects,
            start=start,
            base_only=request.terms == "none",
            audit=found,
            seed=request.seed,
            progress=lambda share, text: progress(share, GUESS, text),
            cache=cache_folder("simgap", "steps"),
        )
    except Interrupted as error:
        error.add_note(GOES_ON)
        raise
    result = replace(result, remarks=(*map(end_sentence, logs.losses), *result.remarks))
    patch = None if request.patch is None else make_patch(robot, *result.of_model(), result.rivals)
    traces: tuple[Trace, ...] = ()
    if request.report is not None:
        made = trace_motions(robot, logs.judged or logs.fit, result, found.usable)
        traces = tuple(convert_trace(robot, one) for one in made)
    return RobotDiagnosis(request, result, traces, patch, digests)


def _diagnose_tracker(
    request: DiagnoseRequest, file: SerialFile, terms: tuple[str, ...], progress: Progress
) -> RobotDiagnosis:
    names = ("split", "held-out", "effects", "start")
    given = {name: getattr(request, name.replace("-", "_")) for name in names}
    _refuse_any(
        {name: bool(value) for name, value in given.items()},
        "is for logs; of poses, the earlier ones are fitted and the later ones judge",
    )
    if len(request.logs) != 1:
        raise BadRequest(f"logs: {len(request.logs)} tables of poses; give one, for one pose of the tracker")
    folder, (table,) = request.robot.parent, request.logs
    if table.name not in file.poses:
        known = ", ".join(file.poses)
        raise RobotError(f"{request.robot}: poses: has no mapping for {table.name}; has {known}")
    path, mapping = folder / file.serial_arm, folder / file.poses[table.name]
    if request.patch is not None:
        check_distinct_files({"serial_arm": path, "patch": request.patch / ARM_FILE})
    arm = read_arm(path)
    series = read_series(arm, table, mapping)
    digests = digest_files({"robot": [request.robot, path, mapping], "log": [table]})
    fitted = fit_tracker(arm, series, terms=terms, fit_share=request.fit_share, progress=progress)
    result = describe_tracker(fitted)
    patched = None if request.patch is None else patch_arm(arm, result.effects, result.sizes)
    return RobotDiagnosis(request, result, (), patched, digests, fitted)


def diagnosis_json(made: RobotDiagnosis) -> dict[str, Any]:
    """Convert a diagnosis to a JSON document, with the calibration where poses were fitted."""
    document = to_document(made.diagnosis)
    return document if made.fitted is None else document | {"calibration": calibration_json(made.fitted)}


def diagnosis_parts(made: RobotDiagnosis) -> list[str | ReportTable]:
    """Show the lines of a diagnosis, and what each term of a calibration gains if that is asked."""
    lines = all_lines(made.diagnosis)
    if made.fitted is None or not made.request.nested:
        return [*lines]
    return [*lines, *calibration_parts(made.fitted)]


def all_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the four lines, then the details."""
    details = detail_lines(diagnosis)
    return [*verdict_lines(diagnosis), *([""] if details else []), *details]


def save_diagnosis_files(made: RobotDiagnosis) -> list[str]:
    """Write the files of a request, and return a line about each; BadOutput if one cannot be written."""
    if made.request.report is not None:
        save_page_of(made, made.request.report)
    folder, apart = made.request.patch, None
    if made.patch is not None and folder is not None:
        try:
            if isinstance(made.patch, Patch):
                write_patch(made.patch, folder)
                if made.patch.runtime:
                    apart = f"{folder / RUNTIME_FILE} has what {MODEL_FILE} lacks: train with both"
            else:
                folder.mkdir(exist_ok=True)
                _write_arm(made, made.patch, folder / ARM_FILE, "named")
                if made.fitted is not None:
                    _write_arm(made, made.fitted.found.arm, folder / CALIBRATED_FILE, "fitted")
        except OSError as error:
            raise BadOutput(f"patch {folder}: cannot be written ({error.strerror})") from error
    return file_lines({"report": made.request.report, "patch": folder, "runtime": apart})


def save_page_of(made: RobotDiagnosis, path: Path) -> None:
    """Write the page; BadOutput if the file cannot be written."""
    digests = {**made.digests, "result": json_sha256(diagnosis_json(made))}
    origin = Origin(command_text("simgap diagnose", made.request), digests)
    save_diagnosis_page(made.diagnosis, made.traces, path, origin)


def _write_arm(made: RobotDiagnosis, arm: SerialArm, path: Path, what: str) -> None:
    about = [
        f"{made.diagnosis.robot}, with links and effects as {what} by a diagnosis.",
        *(f"{name} sha256 {digest}" for name, digest in made.digests.items()),
    ]
    with atomic_write(path, "patch") as file:
        file.write(arm_to_toml(arm, about).encode())


def _check_folder(folder: Path | None) -> None:
    """Check that a folder is there or can be made, before hours of work."""
    if folder is None:
        return
    check_new_path(folder, "patch")
    if folder.exists() and not folder.is_dir():
        raise BadOutput(f"patch {folder}: this is a file; give the path of a folder")
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        raise BadOutput(f"patch {folder}: no right to write there")
    for name in (MODEL_FILE, RUNTIME_FILE, FOUND_FILE, ARM_FILE, CALIBRATED_FILE):
        if (folder / name).is_dir():
            raise BadOutput(f"patch {folder / name}: this is a folder; give another folder for the patch")


def compare_logs(request: CompareRequest, progress: Progress = no_progress) -> Comparison:
    """Read two logs of a robot and compare them; RobotError if a file is wrong, or the check refuses one."""
    check_options(request)
    robot = Robot.from_toml(request.robot)
    whole = replace(robot, file=robot.file and robot.file.model_copy(update={"split": ""}))  # all motions
    sets = [load(whole, [path]) for path in (request.before, request.after)]
    progress(0.0, 0.0, "checking the logs")
    audits = [audit(robot, logs) for logs in sets]
    for found, logs in zip(audits, sets, strict=True):
        check_audit(found, logs.motions)
    before, after = (logs.motions for logs in sets)
    return compare(
        robot,
        before,
        after,
        audits=audits,
        seed=request.seed,
        progress=lambda share, text: progress(share, GUESS, text),
    )
