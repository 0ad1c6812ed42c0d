"""The verb that proposes the next motion: read robot, logs and result, compare motions, write commands."""

import csv
import io
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.checks.audit import audit
from simgap.command.request import NextRequest
from simgap.common.files import digest_files
from simgap.common.options import check_options, command_text
from simgap.common.page import Origin
from simgap.common.progress import GUESS, Progress, no_progress
from simgap.common.report import ReportTable
from simgap.files.motion_rows import conversion
from simgap.loading import load
from simgap.logs import Motion
from simgap.next_motion.family import NAME
from simgap.next_motion.proposal import Proposal, propose_motion
from simgap.patch.text import FOUND_FILE, read_rivals
from simgap.report.next_motion import next_lines, next_tables, save_next_files
from simgap.report.sentences import join_words
from simgap.robot import Robot
from simgap.units import UNITS

DIGITS: Final = ".9g"
"""Digits of a command: finer than any encoder."""


@dataclass(frozen=True, slots=True)
class NextMotion:
    """A proposal with what its files need."""

    request: NextRequest
    robot: Robot
    proposal: Proposal
    motion: Motion
    digests: dict[str, str]
    """SHA-256 of the files that were read."""


def propose_next(request: NextRequest, progress: Progress = no_progress) -> NextMotion:
    """Propose a motion and write nothing; BadRequest or RobotError if an option or a file is wrong."""
    check_options(request)
    progress(0.0, 0.0, "reading")
    robot = Robot.from_toml(request.robot)
    logs = load(robot, request.logs, split=request.split, held_out=request.held_out)
    rivals = read_rivals(robot, request.start, [one.name for one in logs.fit])
    progress(0.0, 0.0, "auditing")
    usable = audit(robot, logs).usable
    proposal, motion = propose_motion(
        robot, logs, rivals, usable, lambda share, text: progress(share, GUESS, text)
    )
    read = {"robot": [request.robot], "log": request.logs, "start": [request.start / FOUND_FILE]}
    return NextMotion(request, robot, proposal, motion, digest_files(read))


def next_parts(made: NextMotion) -> list[str | ReportTable]:
    """Show what to record, the best motions, and what to do with the log."""
    lines = next_lines(made.proposal)
    if not made.proposal.choice.tells_apart:
        allow = "possible_rad of a joint, possible of a condition such as an added mass"
        return [*lines, f"Or let the robot file allow more: {allow}."]
    split = made.robot.file.split if made.robot.file else ""
    names = f'"{NAME}-1" to "{NAME}-{made.proposal.runs}"'
    part = f" in a part of {split} that is fitted" if split else ""
    tables = made.robot.file.conditions if made.robot.file else {}
    listed = [f"conditions.{name}.values" for name, one in tables.items() if one.values]
    given = f", and give their values in {join_words(listed, 'and')}" if listed else ""
    after = (
        f"Begin each run at rest in the first row. Name the runs {names}{part}{given}. Then diagnose the "
        "earlier logs and those of this motion together."
    )
    return [*lines, *next_tables(made.proposal), after]


def save_files(made: NextMotion) -> list[str]:
    """Write the files of a request, and return a line about each; BadOutput if one cannot be written."""
    request, origin = made.request, Origin(command_text("simgap next", made.request), made.digests)
    return save_next_files(
        made.proposal,
        {"commands": request.out},
        lambda: command_table(made.robot, made.motion),
        request.report,
        origin,
    )


def command_table(robot: Robot, motion: Motion) -> str:
    """Return the commands of a motion as CSV, with the columns and the units of the logs of the robot.

    A joint without a command has the column of its position: where it goes.
    """
    assert robot.file is not None
    file, first = robot.file, next(iter(motion.joints.values())).position.time_s
    names = filter(None, (*file.motion.columns, file.motion.repeat_column))  # its runs repeat one another
    columns: dict[str, list[str]] = {name: [NAME] * first.size for name in names}
    times = _texts(first / UNITS[file.time.unit].factor)
    columns[file.time.column or "time"] = times
    for name, table in file.joints.items():
        log = motion.joints[name]
        one, signal = table.position, log.position
        if table.command and log.command:
            one, signal = table.command, log.command
        factor, offset = conversion(one, UNITS[one.unit].quantity, table)
        columns[one.column] = _texts((signal.value - offset) / factor)
        if one.time_column:
            columns[one.time_column] = times
        if table.enabled and log.enabled:
            columns[table.enabled.column] = _texts(log.enabled.value)
        if table.gain_column:
            columns[table.gain_column] = _texts(np.full(first.size, motion.gain[name]))
    for name, condition in file.conditions.items():
        if condition.column:
            columns[condition.column] = _texts(np.full(first.size, motion.conditions[name]))
    text = io.StringIO()
    decimal, separator = file.csv.decimal or ".", file.csv.separator
    rows = ([one.replace(".", decimal) for one in row] for row in zip(*columns.values(), strict=True))
    delimiter = separator or (";" if decimal == "," else ",")
    csv.writer(text, delimiter=delimiter, lineterminator="\n").writerows([[*columns], *rows])
    return text.getvalue()


def _texts(values: Array) -> list[str]:
    return [format(value, DIGITS) for value in values]
