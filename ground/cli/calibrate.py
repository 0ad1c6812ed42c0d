"""The verb `calibrate`; thin."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_BAD_INPUT,
    JsonOption,
    ParamsOption,
    ReportOption,
    SeedOption,
    fail,
    print_result,
)


def calibrate_serial(
    arm: Annotated[Path, typer.Argument(help="The arm: six numbers a link.", metavar="ARM.toml")],
    table: Annotated[
        Path, typer.Argument(help="Joint angles and measured poses, .csv or .parquet.", metavar="TABLE")
    ],
    mapping: Annotated[
        Path, typer.Argument(help="Which columns are what, in which units.", metavar="MAPPING.toml")
    ],
    terms: Annotated[
        str,
        typer.Option(
            help="What to find of the arm: geometry, compliance, waves and approach, joined by commas; none "
            "finds only where base and target are.",
            metavar="TERMS|all|none",
        ),
    ] = "all",
    share: Annotated[
        float, typer.Option(help="Of the poses, from the first in time: they are fitted, the others judge.")
    ] = 0.5,
    ladder: Annotated[
        bool, typer.Option("--ladder", help="Fit term by term: what does each explain?")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Write the arm as it was found.", metavar="FILE.toml")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw what is left, and what the joints err by.", metavar="FILE.png")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find what a serial arm is, and how its joints err, from poses that a laser tracker measured.

    docs/ur10.md says how the files are written, and what came of a real arm. Poses that took no part judge.
    An arm that was found is a file like the first, and can be judged by another table.

    Example: marsarm calibrate-serial models/ur10/arm.toml poses.csv models/ur10/series_a.toml
    """
    from ground.calibration.serial.report import save_serial_figure, serial_json, serial_table
    from ground.calibration.serial.request import SerialRequest
    from ground.calibration.serial.request import calibrate_serial as carry_out
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest

    request = SerialRequest(arm, table, mapping, terms, share, ladder, out, picture)
    try:
        with progress_bar() as progress:
            report = carry_out(request, progress)
            lacking = None if picture is None else save_serial_figure(report, picture)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(serial_json(report, lacking), as_json, lambda: serial_table(report, lacking))


def calibrate(
    arm: Annotated[
        str | None,
        typer.Option(help="Measure this arm in simulation: as-built:SEED or nominal.", metavar="ARM"),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Poses of an arm that was measured, .parquet or .csv; columns in docs/calibration.md.",
            metavar="TABLE",
        ),
    ] = None,
    poses: Annotated[int, typer.Option(help="How many in all, in four groups.")] = 160,
    tracker: Annotated[
        tuple[float, float],
        typer.Option(
            help="Noise of the tracker, one sigma: micrometres, and more per metre.", metavar="UM UM/M"
        ),
    ] = (15.0, 6.0),
    verify: Annotated[
        int,
        typer.Option(help="So many fresh targets each on Earth, Mars and cold Mars, with what was found."),
    ] = 0,
    seed: SeedOption = 0,
    params: ParamsOption = None,
    out: Annotated[Path | None, typer.Option(help="Write flight parameters.", metavar="FILE.toml")] = None,
    save_data: Annotated[
        Path | None, typer.Option(help="Write what was measured.", metavar="FILE.parquet|.csv")
    ] = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the numbers of an arm from poses that a laser tracker measured, and how sure they are.

    In simulation the whole campaign is run: hardstops, every move by flight software, two stand-in turrets,
    level and rolled. What the poses cannot tell apart stays where the drawing has it and is named.

    Example: marsarm calibrate --arm as-built:7 --out arm7.toml --verify 10 --report calibration.html
    """
    from ground.calibration.campaign import CampaignFailed
    from ground.calibration.report import calibration_json, calibration_table, save_calibration_page
    from ground.calibration.request import CalibrateRequest, run_calibration
    from ground.cli.options import EXIT_ARM_SAFE
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest

    request = CalibrateRequest(arm, data, poses, seed, tracker, params, verify, save_data, out, report)
    try:
        with progress_bar() as progress:
            found = run_calibration(request, progress)
            if report is not None:
                save_calibration_page(found, report)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    except CampaignFailed as error:
        fail(str(error), EXIT_ARM_SAFE, as_json)
    print_result(calibration_json(found), as_json, lambda: calibration_table(found))
