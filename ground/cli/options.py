"""Options and exit statuses that verbs share, and functions that print results and errors."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer

from ground.common.errors import UserError

EXIT_BAD_INPUT = 2
EXIT_ARM_SAFE = 3

Vector = tuple[float, float, float]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
ArmOption = Annotated[str, typer.Option(help="nominal, as-built:SEED or calibrated:SEED.", metavar="ARM")]
RollOption = Annotated[float, typer.Option(help="Rover roll, right side down, in degrees.", metavar="DEG")]
PitchOption = Annotated[float, typer.Option(help="Rover pitch, nose up, in degrees.", metavar="DEG")]
SeedOption = Annotated[int, typer.Option(help="Seed of everything random except the arm.")]
ParamsOption = Annotated[
    Path | None,
    typer.Option(help="TOML file of flight parameters that replace nominal ones.", metavar="FILE.toml"),
]
EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Switch on an effect of `marsarm effects`, or FILE.py:CLASS as its name, or all of a FILE.toml "
        "with [[effect]] tables; repeatable.",
        metavar="NAME:PLACE:PARAMETER=VALUE,...",
    ),
]
ReportOption = Annotated[
    Path | None, typer.Option(help="Write a page with tables and pictures.", metavar="FILE.html")
]
DiskOption = Annotated[
    Literal["go-on", "stop"], typer.Option(help="Reaction of the run if its log can no longer be written.")
]


def print_result(document: dict[str, Any], as_json: bool, table: Callable[[], None]) -> None:
    """Print a result as JSON for a program, or as a table for a person."""
    if as_json:
        print(json.dumps(document, indent=2, allow_nan=False))
    else:
        table()


def fail(message: str, status: int, as_json: bool) -> NoReturn:
    """Print an error message and exit."""
    if as_json:
        print(json.dumps({"error": message}))
    print(message, file=sys.stderr)
    raise typer.Exit(status)


@contextmanager
def report_user_errors(as_json: bool) -> Iterator[None]:
    """Print an error of the user, and exit with its status."""
    try:
        yield
    except UserError as error:
        fail(str(error), error.exit_status, as_json)
