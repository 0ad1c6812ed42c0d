"""Define the verb `replay`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import EXIT_ARM_SAFE, EXIT_BAD_INPUT, JsonOption, fail, print_result


def replay(
    log: Annotated[Path, typer.Argument(help="A telemetry log, complete or truncated.", metavar="LOG")],
    channel: Annotated[
        str,
        typer.Option(
            help="Compare only channels that match, such as '/joint.*'; events and lengths always.",
            metavar="GLOB",
        ),
    ] = "*",
    params: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of parameters that replace those of the log.",
            metavar="FILE.toml",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Feed the sensors and commands of a log to today's flight software, and compare its outputs.

    The exit status is 0 if all outputs are identical, 3 if not.

    Example: marsarm replay run.mcap --channel '/joint.*'
    """
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar
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
