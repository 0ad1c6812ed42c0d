"""Define the verbs of the diagnosis: `gap record` and `diagnose`."""

import sys

import typer

from ground.cli.verb import VerbResult, verb
from ground.common.errors import BadRequest
from ground.common.progress import Progress
from ground.diagnosis.arm.request import DiagnoseRequest, RecordRequest

gap_app = typer.Typer(
    help="Record logs from which `marsarm diagnose` finds why arm and simulation differ.\n\n"
    "Example: marsarm gap record --out logs",
    no_args_is_help=True,
)


@gap_app.callback()
def _group() -> None:
    """Make typer keep `record` as a verb, though it is the only one of the group."""


@gap_app.command()
@verb
def record(request: RecordRequest, progress: Progress) -> VerbResult:
    """Record the campaign of motions for `marsarm diagnose`; it takes half a minute.

    Logs hold no truth of the plant. Motions to validate a diagnosis on are in DIR/held-out.

    Example: marsarm gap record --effect link-length:arm3.x:length_m=0.003 --out logs
    """
    from ground.diagnosis.arm.record import record_logs

    paths = record_logs(request, progress)
    document = {"logs": [str(path) for path in paths]}
    return VerbResult(document, lambda: print(f"{len(paths)} logs in {request.out}"))


@verb
def diagnose(request: DiagnoseRequest, progress: Progress) -> VerbResult:
    """Find why an arm and its simulation differ: the effect, its place and the residual that remains.

    The verdict is a name, a set of names, none (no effect is detected) or unknown (not in the catalogue).

    Example: marsarm diagnose logs/ --held-out more/ --report gap.html --patch found.toml
    """
    from ground.diagnosis.arm.diagnose_logs import diagnose_logs, prepare_diagnosis
    from ground.diagnosis.arm.output_files import save_diagnosis_files
    from ground.diagnosis.result import to_json
    from ground.diagnosis.tables import print_diagnosis
    from sim.plant import PlantDiverged

    job = prepare_diagnosis(request)
    try:
        result = diagnose_logs(job, progress)
    except PlantDiverged as error:
        raise BadRequest(str(error)) from error

    def save() -> None:
        for sentence in save_diagnosis_files(result, request, job):
            print(sentence, file=sys.stderr)

    return VerbResult(to_json(result), lambda: print_diagnosis(result), save=save)
