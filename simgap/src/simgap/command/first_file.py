"""Verbs for a user who has no robot file yet: a list of what is in logs, and a first robot file."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from simgap.command.request import CheckRequest, InitRequest
from simgap.common.console import pluralize
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.common.report import ReportTable
from simgap.files.columns import ColumnInfo
from simgap.files.log_file import SUFFIXES, open_whole
from simgap.files.table_log import TableLog
from simgap.setup.compose import draft_robot_file
from simgap.setup.draft import list_questions, robot_file_lines
from simgap.setup.times import find_times
from simgap.setup.units import KEYS
from simgap.units import UNITS


@dataclass(frozen=True, slots=True)
class FirstFile:
    """Robot file that was written."""

    robot_file: Path
    text: str
    columns: dict[str, dict[str, str]]
    """Columns by joint and key."""
    left_out: tuple[str, ...]
    questions: tuple[str, ...]


def write_first_file(request: InitRequest, progress: Progress = no_progress) -> FirstFile:
    """Write a robot file, if it reads the logs; else BadRequest or RobotError, and nothing is written."""
    check_options(request)
    if not request.logs:
        raise BadRequest("logs: none is given; name at least one log after the model")
    if request.out.exists():
        raise BadRequest(f"out {request.out}: is there already; name another file, or remove it")
    try:
        draft = draft_robot_file(request.model, request.logs, request.out, request.unit, progress)
    except RobotError as error:
        if str(error).startswith(f"{request.out}: "):  # which is not there yet
            raise RobotError(f"{error}. So no robot file was written for {request.model}") from error
        raise
    lines = robot_file_lines(draft, f"{request.model.name} and {', '.join(one.name for one in request.logs)}")
    text = "\n".join(lines) + "\n"
    with atomic_write(request.out, "out") as file:
        file.write(text.encode())
    columns = {
        joint: {key: table[key]["column"] for key in KEYS if key in table}
        for joint, table in draft.content["joints"].items()
    }
    left_out = tuple(draft.content.get("left_out", ()))
    return FirstFile(request.out, text, columns, left_out, tuple(list_questions(draft)))


def first_file_parts(made: FirstFile, logs: Sequence[Path]) -> list[str]:
    """Show which column is which joint, what is to be answered, and the next command."""
    return [
        *(
            f"{joint}: {', '.join(f'{key} {column}' for key, column in columns.items())}"
            for joint, columns in made.columns.items()
        ),
        *([f"left out: {', '.join(made.left_out)}"] if made.left_out else []),
        *(f"{number}. {question}" for number, question in enumerate(made.questions, 1)),
        f"{made.robot_file} is written; answer the questions in it, then:",
        shlex.join(["simgap", "check", *map(str, (made.robot_file, *logs))]),
    ]


MODELS: Final = (".xml", ".mjcf", ".urdf")
COLUMN_HEAD: Final = ("column", "kind", "samples", "Hz", "lowest", "highest", "unit")


@dataclass(frozen=True, slots=True)
class LogContent:
    """Columns of a log, and sentences about what of it could not be read."""

    log: Path
    columns: tuple[ColumnInfo, ...]
    losses: tuple[str, ...]


def list_logs(request: CheckRequest, progress: Progress = no_progress) -> tuple[LogContent, ...]:
    """List the columns of logs; BadRequest for a model or a page, RobotError for a log that is damaged."""
    check_options(request)
    if request.robot.suffix.lower() in MODELS:
        raise BadRequest(
            f"{request.robot}: is a model; give a robot file, which `simgap init {request.robot} LOGS` writes"
        )
    if request.report is not None:
        raise BadRequest("report: is of a check; name a robot file before the logs")
    paths = (request.robot, *request.logs)
    found = []
    for number, path in enumerate(paths):
        progress(number, len(paths), f"reading {path.name}")
        try:
            found.append(_describe(path))
        except RobotError as error:
            if path is request.robot and request.logs and path.suffix.lower() not in SUFFIXES:
                raise RobotError(f"{error}; or name a robot file, which ends in .toml") from error
            raise
    return tuple(found)


def _describe(path: Path) -> LogContent:
    """Describe a log; a table has its rates by the column that is a time by its name, if there is one."""
    log = open_whole(path)
    columns, losses = log.describe(), list(log.losses)
    if isinstance(log, TableLog) and not log.time_column:
        try:
            times = find_times(log, columns)
        except RobotError as error:
            losses.append(str(error).removeprefix(f"{path}: "))
        else:
            columns = log.describe(log.numbers(times.column).value * UNITS[times.unit].factor)
    return LogContent(path, columns, tuple(losses))


def columns_parts(logs: Sequence[LogContent]) -> list[str | ReportTable]:
    """Show one line for each column."""
    parts: list[str | ReportTable] = []
    for one in logs:
        title = f"{one.log}: {pluralize(len(one.columns), 'column')}"
        parts.append(ReportTable(COLUMN_HEAD, [*map(_cells, one.columns)], title))
        parts += [f"{one.log}: {loss}" for loss in one.losses]
    last = "A robot file says which of these columns is which joint; `simgap init` writes a first one."
    return [*parts, last]


def _cells(one: ColumnInfo) -> tuple[str, ...]:
    numbers = ("" if number is None else f"{number:.6g}" for number in (one.rate_Hz, one.lowest, one.highest))
    return one.name, one.kind, str(one.n_samples), *numbers, one.unit
