"""Comparison of two logs of a robot: read and check them, and find what differs."""

from dataclasses import replace

from simgap.checks.audit import audit
from simgap.command.request import CompareRequest
from simgap.common.errors import RobotError
from simgap.common.files import cache_folder
from simgap.common.options import check_options
from simgap.common.progress import GUESS, Progress, no_progress
from simgap.compare import AFTER, BEFORE, compare
from simgap.diagnosis import check_audit, end_sentence
from simgap.loading import load
from simgap.result import Comparison
from simgap.robot import Robot


def compare_logs(request: CompareRequest, progress: Progress = no_progress) -> Comparison:
    """Read two logs of a robot and compare them; RobotError if a file is wrong, or the check refuses one."""
    check_options(request)
    robot = Robot.from_toml(request.robot)
    whole = replace(robot, file=robot.file and robot.file.model_copy(update={"split": ""}))  # all motions
    sets = [load(whole, [path]) for path in (request.before, request.after)]
    progress(0.0, 0.0, "checking the logs")
    audits = [audit(robot, logs) for logs in sets]
    for name, found, logs in zip(("before", "after"), audits, sets, strict=True):
        try:
            check_audit(found, logs.motions)
        except RobotError as error:
            raise RobotError(f"{name}: {error}") from error
    before, after = (logs.motions for logs in sets)
    made = compare(
        robot,
        before,
        after,
        audits=audits,
        seed=request.seed,
        progress=lambda share, text: progress(share, GUESS, text),
        cache=cache_folder("simgap", "steps"),
    )
    losses = (
        f"{prefix} {end_sentence(text)}"
        for prefix, logs in zip((BEFORE, AFTER), sets, strict=True)
        for text in logs.losses
    )
    return replace(made, found=replace(made.found, remarks=(*losses, *made.found.remarks)))
