"""Execution of a diagnosis: read robot and logs, audit them, find the effects, write the files."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from simgap.audit.audit import audit
from simgap.catalogue.own_effects import load_effects
from simgap.command.request import RobotDiagnoseRequest
from simgap.common.errors import BadOutput, BadRequest, RobotError
from simgap.common.files import (
    atomic_write,
    cache_folder,
    check_distinct_files,
    check_new_path,
    digest_files,
)
from simgap.common.interruption import Interrupted
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.diagnose import diagnose
from simgap.files.robot_file import SerialFile, read_robot_file
from simgap.load import load
from simgap.logs import Logs, Motion
from simgap.patch.patch import MODEL_FILE, RUNTIME_FILE, Patch, make_patch, write_patch
from simgap.report.traces import Trace, trace_motions
from simgap.result import Diagnosis
from simgap.robot import Robot
from simgap.serial_arm.effects import patch_arm
from simgap.serial_arm.files import arm_to_toml, read_arm, read_series
from simgap.serial_arm.model import SerialArm
from simgap.serial_arm.tracker import diagnose_tracker

GOES_ON: Final = "the same command goes on after its last complete step"
"""Sentence about an interruption."""
ARM_FILE: Final = "arm.toml"
"""File of a serial arm in the folder of a patch."""


@dataclass(frozen=True, slots=True)
class RobotDiagnosis:
    """A diagnosis with what its files need."""

    request: RobotDiagnoseRequest
    diagnosis: Diagnosis
    traces: tuple[Trace, ...]
    """Of held-out motions, or of the fitted ones if none is held out; empty without a report."""
    patch: Patch | SerialArm | None
    digests: dict[str, str]
    """SHA-256 of the files that were read."""


def diagnose_robot(request: RobotDiagnoseRequest, progress: Progress = no_progress) -> RobotDiagnosis:
    """Diagnose a robot; nothing is written but steps in the cache, which are deleted at the end.

    Raises:
        BadRequest: an option is wrong.
        RobotError: the robot file, a log or a file of effects is wrong.
    """
    check_options(request)
    if request.split and request.held_out:
        raise BadRequest("split, held-out: they exclude each other; give one of the two")
    check_distinct_files({"report": request.report, "patch": request.patch})
    _check_folder(request.patch)
    progress(0.0, 0.0, "reading")
    file = read_robot_file(request.robot)
    return (
        _diagnose_tracker(request, file, progress)
        if isinstance(file, SerialFile)
        else _diagnose_logs(request, progress)
    )


def _diagnose_logs(request: RobotDiagnoseRequest, progress: Progress) -> RobotDiagnosis:
    robot = Robot.from_toml(request.robot)
    if request.patch is not None and robot.file is not None:
        check_distinct_files({"model": robot.folder / robot.file.model, "patch": request.patch / MODEL_FILE})
    logs = load(robot, request.logs, split=request.split, held_out=request.held_out)
    effects = [one for path in request.effects for one in load_effects(path, robot, logs)]
    digests = digest_files({"robot": [request.robot], "log": request.logs, "effects": request.effects})
    progress(0.0, 0.0, "auditing")
    found = audit(robot, logs)
    try:
        result = diagnose(
            robot,
            logs.fit,
            held_out=logs.judged,
            effects=effects,
            audit=found,
            seed=request.seed,
            progress=lambda share, text: progress(share, 1.0, text),
            cache=cache_folder("robot-steps"),
        )
    except Interrupted as error:
        error.add_note(GOES_ON)
        raise
    patch = None if request.patch is None else make_patch(robot, *result.of_model())
    traces = () if request.report is None else trace_motions(robot, _shown(logs), result, found.usable)
    return RobotDiagnosis(request, result, traces, patch, digests)


def _diagnose_tracker(request: RobotDiagnoseRequest, file: SerialFile, progress: Progress) -> RobotDiagnosis:
    given = {"split": request.split, "held-out": request.held_out, "effects": request.effects}
    wrong = next((name for name, value in given.items() if value), None)
    if wrong:
        raise BadRequest(
            f"{wrong}: is for logs; of poses, the earlier half is fitted and the later one judges"
        )
    if len(request.logs) != 1:
        raise BadRequest(f"logs: {len(request.logs)} tables of poses; give one, for one pose of the tracker")
    folder, (table,) = request.robot.parent, request.logs
    if table.name not in file.poses:
        raise RobotError(
            f"{request.robot}: poses: has no mapping for {table.name}; has {', '.join(file.poses)}"
        )
    path, mapping = folder / file.serial_arm, folder / file.poses[table.name]
    if request.patch is not None:
        check_distinct_files({"serial_arm": path, "patch": request.patch / ARM_FILE})
    arm = read_arm(path)
    series = read_series(arm, table, mapping)
    digests = digest_files({"robot": [request.robot, path, mapping], "log": [table]})
    result = diagnose_tracker(arm, series, progress=progress)
    patched = None if request.patch is None else patch_arm(arm, result.effects, result.sizes)
    return RobotDiagnosis(request, result, (), patched, digests)


def save_diagnosis_files(made: RobotDiagnosis) -> None:
    """Write the files of a request.

    Raises:
        BadOutput: a file cannot be written.
    """
    from simgap.command.diagnosis_page import save_diagnosis_page

    if made.request.report is not None:
        save_diagnosis_page(made, made.request.report)
    folder = made.request.patch
    if made.patch is not None and folder is not None:
        try:
            if isinstance(made.patch, Patch):
                write_patch(made.patch, folder)
            else:
                folder.mkdir(exist_ok=True)
                with atomic_write(folder / ARM_FILE, "patch") as file:
                    file.write(arm_to_toml(made.patch, _origin(made)).encode())
        except OSError as error:
            raise BadOutput(f"patch {folder}: cannot be written ({error.strerror})") from error


def _origin(made: RobotDiagnosis) -> list[str]:
    return [
        f"{made.diagnosis.robot}, with the links and effects that a diagnosis found.",
        *(f"{name} sha256 {digest}" for name, digest in made.digests.items()),
    ]


def _shown(logs: Logs) -> tuple[Motion, ...]:
    return logs.judged or logs.fit


def _check_folder(folder: Path | None) -> None:
    """Check that a folder is there or can be made, before hours of work.

    Raises:
        BadOutput: it is a file, or its parent is missing.
    """
    if folder is None:
        return
    check_new_path(folder, "patch")
    if folder.exists() and not folder.is_dir():
        raise BadOutput(f"patch {folder}: this is a file; give the path of a folder")
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        raise BadOutput(f"patch {folder}: no right to write there")
    for name in (MODEL_FILE, RUNTIME_FILE, ARM_FILE):
        if (folder / name).is_dir():
            raise BadOutput(f"patch {folder / name}: this is a folder; give another folder for the patch")
