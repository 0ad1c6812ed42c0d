"""The verb `calibrate`; thin."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import BAD_INPUT, JsonOption, ParamsOption, ReportOption, SeedOption, end, show


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
    from ground.cli.options import ARM_SAFE
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest

    request = CalibrateRequest(arm, data, poses, seed, tracker, params, verify, save_data, out, report)
    try:
        with progress_bar() as progress:
            found = run_calibration(request, progress)
            if report is not None:
                save_calibration_page(found, report)
    except BadRequest as error:
        end(str(error), BAD_INPUT, as_json)
    except CampaignFailed as error:
        end(str(error), ARM_SAFE, as_json)
    show(calibration_json(found), as_json, lambda: calibration_table(found))
