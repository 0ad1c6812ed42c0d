"""Define the verbs `calibrate` and `calibrate-serial`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_ARM_SAFE,
    EXIT_BAD_INPUT,
    JsonOption,
    ParamsOption,
    ReportOption,
    SeedOption,
    fail,
    print_result,
)


def calibrate_serial(
    arm: Annotated[Path, typer.Argument(help="The arm: six numbers for each link.", metavar="ARM.toml")],
    table: Annotated[
        Path, typer.Argument(help="Joint angles and measured poses, .csv or .parquet.", metavar="TABLE")
    ],
    mapping: Annotated[Path, typer.Argument(help="Meaning and unit of each column.", metavar="MAPPING.toml")],
    terms: Annotated[
        str,
        typer.Option(
            help="Terms to fit: geometry, compliance, waves and approach, joined by commas; none fits only "
            "base and target.",
            metavar="TERMS|all|none",
        ),
    ] = "all",
    share: Annotated[
        float,
        typer.Option(help="Share of the poses to fit, the earliest ones; the others are held out."),
    ] = 0.5,
    nested: Annotated[
        bool, typer.Option("--ladder", help="Fit term by term, and show what each explains.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Write the fitted arm.", metavar="FILE.toml")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the residuals and the joint errors.", metavar="FILE.png")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find the geometry and the joint errors of a serial arm from poses that a laser tracker measured.

    docs/ur10.md describes the files and the results of a real arm. Held-out poses validate the fit. A fitted
    arm is a file like the first, and can be validated on another table.

    Example: marsarm calibrate-serial models/ur10/arm.toml poses.csv models/ur10/series_a.toml
    """
    from ground.calibration.serial.report import save_serial_figure, serial_json, serial_table
    from ground.calibration.serial.request import SerialRequest
    from ground.calibration.serial.request import calibrate_serial as carry_out
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar

    request = SerialRequest(arm, table, mapping, terms, share, nested, out, picture)
    try:
        with progress_bar() as progress:
            report = carry_out(request, progress)
            picture_problem = None if picture is None else save_serial_figure(report, picture)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(serial_json(report, picture_problem), as_json, lambda: serial_table(report, picture_problem))


def calibrate(
    arm: Annotated[
        str | None,
        typer.Option(help="Measure this arm in simulation: as-built:SEED or nominal.", metavar="ARM"),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Measured poses of an arm, .parquet or .csv; columns in docs/calibration.md.",
            metavar="TABLE",
        ),
    ] = None,
    poses: Annotated[int, typer.Option(help="Number of poses, in four groups.")] = 160,
    tracker: Annotated[
        tuple[float, float],
        typer.Option(
            help="Noise of the tracker, one sigma: micrometres, and micrometres per metre.",
            metavar="UM UM/M",
        ),
    ] = (15.0, 6.0),
    verify: Annotated[
        int,
        typer.Option(help="Number of new targets on each of Earth, Mars and cold Mars to verify with."),
    ] = 0,
    seed: SeedOption = 0,
    params: ParamsOption = None,
    out: Annotated[Path | None, typer.Option(help="Write flight parameters.", metavar="FILE.toml")] = None,
    save_data: Annotated[
        Path | None, typer.Option(help="Write the measured poses.", metavar="FILE.parquet|.csv")
    ] = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the parameters of an arm and their uncertainty from poses that a laser tracker measured.

    In simulation the whole campaign is run: hardstops, every move by flight software, two stand-in turrets,
    level and rolled. Parameters that the poses cannot separate keep their nominal values and are listed.

    Example: marsarm calibrate --arm as-built:7 --out arm7.toml --verify 10 --report calibration.html
    """
    from ground.calibration.campaign import CampaignFailed
    from ground.calibration.report import calibration_json, calibration_table, save_calibration_page
    from ground.calibration.request import CalibrateRequest, run_calibration
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar

    request = CalibrateRequest(arm, data, poses, seed, tracker, params, verify, save_data, out, report)
    try:
        with progress_bar() as progress:
            result = run_calibration(request, progress)
            if report is not None:
                save_calibration_page(result, report)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    except CampaignFailed as error:
        fail(str(error), EXIT_ARM_SAFE, as_json)
    print_result(calibration_json(result), as_json, lambda: calibration_table(result))
