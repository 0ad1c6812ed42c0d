"""Define the verbs `run` and `scenarios`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_ARM_SAFE,
    EXIT_BAD_INPUT,
    DiskOption,
    EffectOption,
    JsonOption,
    SeedOption,
    fail,
    print_result,
)


def run(
    scenario: Annotated[
        str, typer.Argument(help="A name from `marsarm scenarios`, or a .toml file.", metavar="SCENARIO")
    ],
    arm: Annotated[
        str | None,
        typer.Option(
            help="nominal, as-built:SEED or calibrated:SEED; that of the scenario if not given.",
            metavar="ARM",
        ),
    ] = None,
    tilt: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Tilt of the rover, degrees: roll, right side down, and pitch, nose up; if not given, that "
            "of the scenario.",
            metavar="ROLL PITCH",
        ),
    ] = None,
    seed: SeedOption = 0,
    effect: EffectOption = None,
    log: Annotated[
        Path | None, typer.Option(help="Write a telemetry log (MCAP).", metavar="FILE.mcap")
    ] = None,
    when_disk_full: DiskOption = "go-on",
    movie: Annotated[Path | None, typer.Option(help="Draw the whole run.", metavar="FILE.gif")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the arm at the last check.", metavar="FILE.png")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario in the closed loop, and check it against the true motion of the arm.

    Example: marsarm run tool-change --arm calibrated:7 --tilt 10 -5 --movie sol46.gif
    """
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar
    from ground.runs.execution import RunFiles
    from ground.runs.scenario import RunRequest
    from ground.runs.scenario import run as carry_out
    from ground.runs.tables import run_json, run_table

    files = RunFiles(log, picture, movie, when_disk_full)
    request = RunRequest(scenario, arm, tilt, seed, files, tuple(effect or ()))
    try:
        with progress_bar() as progress:
            report = carry_out(request, progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(run_json(report), as_json, lambda: run_table(report))
    if not report.passed:
        raise typer.Exit(EXIT_ARM_SAFE)


def scenarios(as_json: JsonOption = False) -> None:
    """List the built-in scenarios.

    Example: marsarm scenarios --json
    """
    from ground.runs.tables import scenarios_json, scenarios_table
    from sim.scenario.file import built_in_scenarios, load_scenario

    loaded = tuple(load_scenario(name) for name in built_in_scenarios())
    print_result({"scenarios": scenarios_json(loaded)}, as_json, lambda: scenarios_table(loaded))
