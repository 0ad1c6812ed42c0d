"""The verb that writes a first robot file from a model and logs."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap.command.request import InitRequest
from simgap.common.console import plain_console
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.setup.compose import draft_robot_file
from simgap.setup.draft import list_questions, robot_file_text
from simgap.setup.signals import KEYS


@dataclass(frozen=True, slots=True)
class FirstFile:
    """Robot file that was written."""

    path: Path
    text: str
    columns: dict[str, dict[str, str]]
    """Columns by joint and key."""
    left_out: tuple[str, ...]
    questions: tuple[str, ...]
    logs: tuple[Path, ...]


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
    text = robot_file_text(draft, f"{request.model.name} and {', '.join(one.name for one in request.logs)}")
    with atomic_write(request.out, "out") as file:
        file.write(text.encode())
    columns = {
        joint: {key: table[key]["column"] for key in KEYS if key in table}
        for joint, table in draft.content["joints"].items()
    }
    left_out = tuple(draft.content.get("left_out", ()))
    return FirstFile(request.out, text, columns, left_out, tuple(list_questions(draft)), request.logs)


def first_file_json(made: FirstFile) -> dict[str, Any]:
    """Convert the result to a JSON document."""
    return {
        "robot_file": str(made.path),
        "text": made.text,
        "columns": made.columns,
        "left_out": list(made.left_out),
        "questions": list(made.questions),
    }


def print_first_file(made: FirstFile) -> None:
    """Print which column is which joint, what is to be answered, and the next command."""
    console = plain_console()
    for joint, columns in made.columns.items():
        console.print(f"{joint}: {', '.join(f'{key} {column}' for key, column in columns.items())}")
    if made.left_out:
        console.print(f"left out: {', '.join(made.left_out)}")
    for number, question in enumerate(made.questions, 1):
        console.print(f"{number}. {question}")
    console.print(f"{made.path} is written; answer the questions in it, then:")
    console.print(shlex.join(["simgap", "check", *map(str, (made.path, *made.logs))]), soft_wrap=True)
