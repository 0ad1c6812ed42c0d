"""The verb `calibrate-serial`; thin."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import BAD_INPUT, JsonOption, end, show


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
        end(str(error), BAD_INPUT, as_json)
    show(serial_json(report, lacking), as_json, lambda: serial_table(report, lacking))
