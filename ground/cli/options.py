"""What the verbs of the command line share: options, exit statuses, and how results are shown."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer

EXIT_BAD_INPUT = 2
EXIT_ARM_SAFE = 3

Vector = tuple[float, float, float]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
ArmOption = Annotated[str, typer.Option(help="nominal, as-built:SEED or calibrated:SEED.", metavar="ARM")]
RollOption = Annotated[float, typer.Option(help="Rover roll, right side down, in degrees.", metavar="DEG")]
PitchOption = Annotated[float, typer.Option(help="Rover pitch, nose up, in degrees.", metavar="DEG")]
SeedOption = Annotated[int, typer.Option(help="Of everything random that is not the arm.")]
ParamsOption = Annotated[
    Path | None,
    typer.Option(help="TOML with flight parameters that replace nominal ones.", metavar="FILE.toml"),
]
EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Switch an effect on, one from `marsarm effects` or FILE.py:CLASS for its name, or those of a "
        "FILE.toml with [[effect]] tables; as often as you like.",
        metavar="NAME:PLACE:PARAMETER=VALUE,...",
    ),
]
ReportOption = Annotated[
    Path | None, typer.Option(help="Write a page with tables and pictures.", metavar="FILE.html")
]
DiskOption = Annotated[
    Literal["go-on", "stop"], typer.Option(help="What the run does when its log can no longer be written.")
]


def print_result(document: dict[str, Any], as_json: bool, table: Callable[[], None]) -> None:
    """Print a result, for a program or for a person."""
    if as_json:
        print(json.dumps(document, indent=2, allow_nan=False))
    else:
        table()


def fail(message: str, status: int, as_json: bool) -> NoReturn:
    """Say why nothing was done, and end."""
    if as_json:
        print(json.dumps({"error": message}))
    print(message, file=sys.stderr)
    raise typer.Exit(status)
