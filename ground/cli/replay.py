"""Define the verb `replay`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.verb import VerbResult, verb
from ground.common.progress import Progress


@verb
def replay(
    progress: Progress,
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
        typer.Option(help="TOML file of parameters that replace those of the log.", metavar="FILE.toml"),
    ] = None,
) -> VerbResult:
    """Feed the sensors and commands of a log to today's flight software, and compare its outputs.

    The exit status is 0 if all outputs are identical, 3 if not.

    Example: marsarm replay run.mcap --channel '/joint.*'
    """
    from ground.replay.replay import ReplayRequest, replay
    from ground.replay.tables import replay_json, replay_table

    report = replay(ReplayRequest(log, channel, params), progress)
    return VerbResult(replay_json(report), lambda: replay_table(report), report.differences.identical)
