"""A diagnosis by logs or by poses: read robot and data, find the effects, print them and write the files."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simgap.arrays import Array
from simgap.catalogue.own_effects import load_effects
from simgap.checks.audit import audit
from simgap.command.request import ARM_FILE, CALIBRATED_FILE, FIT_SHARE, DiagnoseRequest
from simgap.common.errors import BadOutput, BadRequest
from simgap.common.files import (
    cache_folder,
    check_distinct_files,
    check_new_path,
    check_output,
    digest_files,
    json_sha256,
)
from simgap.common.options import check_options, command_text
from simgap.common.page import Origin
from simgap.common.progress import GUESS, Progress, no_progress
from simgap.common.report import ReportTable, file_lines
from simgap.diagnosis import diagnose, end_sentence
from simgap.effects.effect import Effect
from simgap.files.robot_file import SerialFile, read_robot_file
from simgap.loading import load
from simgap.report.details import detail_lines
from simgap.report.document import to_document
from simgap.report.page import save_diagnosis_page
from simgap.report.sentences import verdict_lines
from simgap.report.traces import Trace, convert_trace, trace_motions
from simgap.result import Diagnosis
from simgap.robot import Robot

if TYPE_CHECKING:  # what only poses or a patch need is loaded where it is used
    from simgap.command.poses import PoseDiagnosis
    from simgap.patch.patch import Patch


@dataclass(frozen=True, slots=True)
class RobotDiagnosis:
    """A diagnosis with what its files need."""

    request: DiagnoseRequest
    diagnosis: Diagnosis
    traces: tuple[Trace, ...]
    """Of held-out motions, or of the fitted ones if none is held out; empty without a report."""
    patch: "Patch | None"
    digests: dict[str, str]
    """SHA-256 of the files that were read."""
    by_poses: "PoseDiagnosis | None" = None


def diagnose_robot(request: DiagnoseRequest, progress: Progress = no_progress) -> RobotDiagnosis:
    """Diagnose a robot, writing in the cache alone; BadRequest or RobotError if anything given is wrong."""
    check_options(request)
    if request.split and request.held_out:
        raise BadRequest("split, held-out: they exclude each other; give one of the two")
    check_distinct_files({"report": request.report, "start": request.start, "patch": request.patch})
    _check_folder(request.patch)
    progress(0.0, 0.0, "reading")
    file = read_robot_file(request.robot)
    if isinstance(file, SerialFile):
        from simgap.command.poses import diagnose_poses  # logs need none of its modules

        made = diagnose_poses(request, file, progress)
        return RobotDiagnosis(request, made.diagnosis, (), None, made.digests, made)
    given = {
        f"terms {request.terms!r}": request.terms not in ("all", "none"),
        "fit-share": request.fit_share != FIT_SHARE,
        "nested": request.nested,
    }
    wrong = next((name for name, is_given in given.items() if is_given), None)
    if wrong:
        raise BadRequest(f"{wrong}: is for poses of a tracker; this robot file has a model and logs")
    if request.terms == "none" and request.effects:
        raise BadRequest("effects: none is looked for with terms none; leave one of the two away")
    return _diagnose_logs(request, progress)


def _diagnose_logs(request: DiagnoseRequest, progress: Progress) -> RobotDiagnosis:
    robot = Robot.from_toml(request.robot)
    if request.patch is not None and robot.file is not None:
        from simgap.patch.text import MODEL_FILE

        model = robot.path.parent / robot.file.model
        check_distinct_files({"model": model, "patch": request.patch / MODEL_FILE})
    logs = load(robot, request.logs, split=request.split, held_out=request.held_out)
    effects = [one for path in request.effects for one in load_effects(path, robot, logs)]
    files = {"robot": [request.robot], "log": request.logs, "effects": request.effects}
    start: dict[Effect, Array] = {}
    if request.start is not None:
        from simgap.patch.text import FOUND_FILE, read_found

        start, files["start"] = read_found(robot, request.start), [request.start / FOUND_FILE]
    digests = digest_files(files)
    progress(0.0, 0.0, "auditing")
    found = audit(robot, logs)
    progress(0.0, 0.0, "preparing the fit")
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
    result = replace(result, remarks=(*map(end_sentence, logs.losses), *result.remarks))
    patch = None
    if request.patch is not None:
        from simgap.patch.patch import make_patch

        patch = make_patch(robot, *result.of_model(), result.rivals, result.fitted_motions)
    traces: tuple[Trace, ...] = ()
    if request.report is not None:
        made = trace_motions(robot, logs.judged or logs.fit, result, found.usable)
        traces = tuple(convert_trace(robot, one) for one in made)
    return RobotDiagnosis(request, result, traces, patch, digests)


def diagnosis_json(made: RobotDiagnosis) -> dict[str, Any]:
    """Convert a diagnosis to a JSON document, with the calibration where poses were fitted."""
    document = to_document(made.diagnosis)
    return document if made.by_poses is None else document | {"calibration": made.by_poses.document()}


def diagnosis_parts(made: RobotDiagnosis) -> list[str | ReportTable]:
    """Show the lines of a diagnosis, and what each term of a calibration gains if that is asked."""
    lines = all_lines(made.diagnosis)
    if made.by_poses is None or not made.request.nested:
        return [*lines]
    return [*lines, *made.by_poses.parts()]


def all_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the four lines, then the details."""
    details = detail_lines(diagnosis)
    return [*verdict_lines(diagnosis), *([""] if details else []), *details]


def save_diagnosis_files(made: RobotDiagnosis) -> list[str]:
    """Write the files of a request, and return a line about each; BadOutput if one cannot be written."""
    if made.request.report is not None:
        save_page_of(made, made.request.report)
    folder, apart = made.request.patch, None
    if folder is not None:
        try:
            if made.patch is not None:
                from simgap.patch.patch import RUNTIME_FILE, write_patch
                from simgap.patch.text import MODEL_FILE

                write_patch(made.patch, folder)
                if made.patch.runtime:
                    apart = f"{folder / RUNTIME_FILE} has what {MODEL_FILE} lacks: train with both"
            elif made.by_poses is not None:
                made.by_poses.write(folder)
        except OSError as error:
            raise BadOutput(f"patch {folder}: cannot be written ({error.strerror})") from error
    return file_lines({"report": made.request.report, "patch": folder, "runtime": apart})


def save_page_of(made: RobotDiagnosis, path: Path) -> None:
    """Write the page; BadOutput if the file cannot be written."""
    digests = {**made.digests, "result": json_sha256(diagnosis_json(made))}
    origin = Origin(command_text("simgap diagnose", made.request), digests)
    save_diagnosis_page(made.diagnosis, made.traces, path, origin)


def _check_folder(folder: Path | None) -> None:
    """Check that a folder is there or can be made, before hours of work."""
    if folder is None:
        return
    from simgap.patch.patch import RUNTIME_FILE
    from simgap.patch.text import FOUND_FILE, MODEL_FILE

    check_new_path(folder, "patch")
    if folder.exists() and not folder.is_dir():
        raise BadOutput(f"patch {folder}: this is a file; give the path of a folder")
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        raise BadOutput(f"patch {folder}: no right to write there")
    for name in (MODEL_FILE, RUNTIME_FILE, FOUND_FILE, ARM_FILE, CALIBRATED_FILE):
        if (folder / name).is_dir():
            raise BadOutput(f"patch {folder / name}: this is a folder; give another folder for the patch")
        if folder.exists():
            check_output(folder / name, (".toml", ".xml"), "patch")
