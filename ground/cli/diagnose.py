"""Define the verb `diagnose`."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_BAD_INPUT,
    EffectOption,
    JsonOption,
    ParamsOption,
    ReportOption,
    SeedOption,
    fail,
    print_result,
)

LogsArgument = Annotated[
    list[Path], typer.Argument(help="Logs, or folders: all .mcap files in them.", metavar="LOG...")
]
HeldOutOption = Annotated[
    list[Path] | None,
    typer.Option(
        help="Logs that are not fitted; the reduction of their residuals validates the result; repeatable.",
        metavar="LOG",
    ),
]
CatalogueOption = Annotated[
    str | None,
    typer.Option(
        help="Effects of `marsarm effects` that may be the cause; all of them if not given.",
        metavar="NAME,NAME,...",
    ),
]
CampaignOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder with logs of the campaign that these repeat; it caches the sensitivities. Without it "
        "the sensitivities of the logs themselves are computed, which takes minutes.",
        metavar="DIR",
    ),
]
PatchOption = Annotated[
    Path | None, typer.Option(help="Write the identified effects, for --effect.", metavar="FILE.toml")
]
NewParamsOption = Annotated[
    Path | None,
    typer.Option(help="Write flight parameters with these effects, for --params.", metavar="FILE.toml"),
]


def diagnose(
    log: LogsArgument,
    held_out: HeldOutOption = None,
    params: ParamsOption = None,
    catalogue: CatalogueOption = None,
    campaign: CampaignOption = None,
    effect: EffectOption = None,
    seed: SeedOption = 0,
    patch: PatchOption = None,
    new_params: NewParamsOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find why an arm and its simulation differ: the effect, its place and the residual that remains.

    The verdict is a name, a set of names, none (no effect is detected) or unknown (not in the catalogue).

    Example: marsarm diagnose logs/ --held-out more/ --report gap.html --patch found.toml
    """
    from ground.common.errors import BadOutput, BadRequest
    from ground.common.progress import progress_bar
    from ground.diagnosis.arm.diagnose_logs import build_request, diagnose_logs
    from ground.diagnosis.arm.logs import NotForDiagnosis
    from ground.diagnosis.arm.output_files import DiagnosisFiles, check_diagnosis_files, save_diagnosis_files
    from ground.diagnosis.result import to_json
    from ground.diagnosis.tables import print_diagnosis
    from sim.plant import PlantDiverged

    files = DiagnosisFiles(report, patch, new_params)
    try:
        check_diagnosis_files(files, params, effect or ())
        request = build_request(log, held_out or (), params, catalogue, campaign, seed, effect or ())
        with progress_bar() as progress:
            result = diagnose_logs(request, progress)
    except (BadRequest, BadOutput, NotForDiagnosis, PlantDiverged) as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(to_json(result), as_json, lambda: print_diagnosis(result))
    try:
        for sentence in save_diagnosis_files(result, request, files):
            print(sentence, file=sys.stderr)
    except BadRequest as error:  # the result took minutes, so it is printed before the files are written
        print(error, file=sys.stderr)
        raise typer.Exit(EXIT_BAD_INPUT) from error
