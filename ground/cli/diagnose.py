"""The verb `diagnose`; thin."""

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


def diagnose(
    log: Annotated[
        list[Path],
        typer.Argument(help="Logs, or folders: all .mcap files in them.", metavar="LOG..."),
    ],
    held_out: Annotated[
        list[Path] | None,
        typer.Option(
            help="Logs that take no part, to see on them how far the gap shrinks; as often as you like.",
            metavar="LOG",
        ),
    ] = None,
    params: ParamsOption = None,
    catalogue: Annotated[
        str | None,
        typer.Option(
            help="Effects that may be the cause, from `marsarm effects`; all of them if not given.",
            metavar="NAME,NAME,...",
        ),
    ] = None,
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Folder with logs of the campaign that these repeat; its sensitivities are kept there. "
            "Without it those of the logs themselves are computed, which takes minutes.",
            metavar="DIR",
        ),
    ] = None,
    effect: EffectOption = None,
    seed: SeedOption = 0,
    patch: Annotated[
        Path | None,
        typer.Option(help="Write the effects that were found, for --effect.", metavar="FILE.toml"),
    ] = None,
    new_params: Annotated[
        Path | None,
        typer.Option(help="Write flight parameters that know them, for --params.", metavar="FILE.toml"),
    ] = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Why an arm is not where its simulator has it: where the gap is, which effect, how far it shrinks.

    The verdict is a name, a set of names, none (no effect is seen) or unknown (not in the catalogue).

    Example: marsarm diagnose logs/ --held-out more/ --report gap.html --patch found.toml
    """
    from ground.common.files import BadOutput
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest
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
    except BadRequest as error:  # after minutes: what was found is told all the same
        print(error, file=sys.stderr)
        raise typer.Exit(EXIT_BAD_INPUT) from error
