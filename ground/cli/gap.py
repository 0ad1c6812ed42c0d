"""Define the verb `gap record`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    ArmOption,
    EffectOption,
    JsonOption,
    ParamsOption,
    SeedOption,
    print_result,
    report_user_errors,
)

gap_app = typer.Typer(
    help="Record logs from which `marsarm diagnose` finds why arm and simulation differ.\n\n"
    "Example: marsarm gap record --out logs",
    no_args_is_help=True,
)


@gap_app.callback()
def _group() -> None:
    """Make typer keep `record` as a verb, though it is the only one of the group."""


@gap_app.command()
def record(
    out: Annotated[Path, typer.Option(help="A new folder for the logs.", metavar="DIR")],
    arm: ArmOption = "nominal",
    effect: EffectOption = None,
    params: ParamsOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Record the campaign of motions for `marsarm diagnose`; it takes half a minute.

    Logs hold no truth of the plant. Motions to validate a diagnosis on are in DIR/held-out.

    Example: marsarm gap record --effect link-length:arm3.x:length_m=0.003 --out logs
    """
    from ground.common.progress import progress_bar
    from ground.diagnosis.arm.record import RecordRequest, check_record_request, record_logs

    request = RecordRequest(out, arm, tuple(effect or ()), params, seed)
    with report_user_errors(as_json):
        check_record_request(request)
        with progress_bar() as progress:
            paths = record_logs(request, progress)
    document = {"logs": [str(path) for path in paths]}
    print_result(document, as_json, lambda: print(f"{len(paths)} logs in {out}"))
