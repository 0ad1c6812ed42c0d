"""Define the verbs of `marsarm robot`."""

import typer

from ground.cli.verb import VerbResult, verb
from ground.common.progress import Progress
from ground.robot.request import CheckRequest

robot_app = typer.Typer(
    help="Check and diagnose any robot from its MuJoCo model and its logs.\n\n"
    "Example: marsarm robot check models/robots/so101/robot.toml so101.parquet",
    no_args_is_help=True,
)


@robot_app.callback()
def _group() -> None:
    """Make typer keep `check` as a verb, though it is the only one of the group."""


@robot_app.command()
@verb
def check(request: CheckRequest, progress: Progress) -> VerbResult:
    """Check a robot file and its logs before a diagnosis, and simulate the model as it is.

    It lists rates, missing and stale rows, units that look wrong, saturation, commands that are cut off and
    contact with a plane, and says which rows a diagnosis will leave out. docs/robot.md describes the files.

    Example: marsarm robot check robot.toml logs.parquet --report check.html
    """
    from ground.robot.execution import check_robot
    from ground.robot.page import save_check_page
    from ground.robot.tables import check_json, print_check

    report = check_robot(request, progress)
    if request.report is not None:
        save_check_page(report, request.report)
    return VerbResult(check_json(report), lambda: print_check(report))
