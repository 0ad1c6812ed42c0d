"""The verb `replay`; thin."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import EXIT_ARM_SAFE, EXIT_BAD_INPUT, JsonOption, fail, print_result


def replay(
    log: Annotated[Path, typer.Argument(help="A telemetry log, whole or cut short.", metavar="LOG")],
    channel: Annotated[
        str,
        typer.Option(
            help="Compare only channels that match, such as '/joint.*'; events and lengths in any case.",
            metavar="GLOB",
        ),
    ] = "*",
    params: Annotated[
        Path | None,
        typer.Option(
            help="TOML with parameters in place of those in the log: what would it have done?",
            metavar="FILE.toml",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Feed a log's sensors and commands through today's flight software, and compare what it puts out.

    The exit status is 0 if all is the same, 3 if not.

    Example: marsarm replay run.mcap --channel '/joint.*'
    """
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest
    from ground.replay.replay import ReplayRequest
    from ground.replay.replay import replay as carry_out
    from ground.replay.tables import replay_json, replay_table

    try:
        with progress_bar() as progress:
            report = carry_out(ReplayRequest(log, channel, params), progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(replay_json(report), as_json, lambda: replay_table(report))
    if not report.differences.identical:
        raise typer.Exit(EXIT_ARM_SAFE)
