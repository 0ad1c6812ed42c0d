"""Define the verbs of `marsarm robot`."""

import typer

from simgap.command.request import CheckRequest, RobotDiagnoseRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb

robot_app = typer.Typer(
    help="Check and diagnose any robot from its MuJoCo model and its logs.\n\n"
    "Example: marsarm robot check models/robots/so101/robot.toml so101.parquet",
    no_args_is_help=True,
)


@robot_app.command()
@verb
def check(request: CheckRequest, progress: Progress) -> VerbResult:
    """Check a robot file and its logs before a diagnosis, and simulate the model as it is.

    It lists rates, missing and stale rows, units that look wrong, saturation, commands that are cut off and
    contact with a plane, and says which rows a diagnosis will leave out. docs/robot.md describes the files.

    Example: marsarm robot check robot.toml logs.parquet --report check.html
    """
    from simgap.command.execution import check_robot
    from simgap.command.page import save_check_page
    from simgap.command.tables import check_json, print_check

    report = check_robot(request, progress)
    if request.report is not None:
        save_check_page(report, request.report)
    return VerbResult(check_json(report), lambda: print_check(report))


@robot_app.command()
@verb
def diagnose(request: RobotDiagnoseRequest, progress: Progress) -> VerbResult:
    """Find why a robot and its model differ: where, which effect, how far, and what to record next.

    Motions that are held out take no part in the fit, and judge it. docs/robot.md describes the files, and
    how to read the verdict. The patch holds the changed model, and a file for simgap.patch.runtime.

    Example: marsarm robot diagnose robot.toml logs.parquet --report found.html --patch found
    """
    from simgap.command.diagnosis import diagnose_robot, save_diagnosis_files
    from simgap.command.diagnosis_page import print_diagnosis
    from simgap.report.document import to_document

    made = diagnose_robot(request, progress)
    return VerbResult(
        to_document(made.diagnosis), lambda: print_diagnosis(made), save=lambda: save_diagnosis_files(made)
    )
