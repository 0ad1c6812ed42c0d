"""The verb `log import`; thin."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ground.cli.options import EXIT_BAD_INPUT, JsonOption, fail, print_result

if TYPE_CHECKING:
    from ground.telemetry.read import Log

LogArgument = Annotated[Path, typer.Argument(help="A telemetry log (MCAP).", metavar="LOG")]
FromOption = Annotated[
    float | None, typer.Option("--from", help="Seconds of log time to begin at.", metavar="S")
]
ToOption = Annotated[
    float | None, typer.Option("--to", help="Seconds of log time to end before.", metavar="S")
]

log_app = typer.Typer(
    help="Look into telemetry logs, export and recover them.\n\nExample: marsarm log info run.mcap",
    no_args_is_help=True,
)


@log_app.command()
def info(log: LogArgument, as_json: JsonOption = False) -> None:
    """What a log holds: versions, duration, topics, events; whether it is whole.

    Example: marsarm log info run.mcap
    """
    from ground.telemetry.tables import info_json, info_table

    with _bad_input(as_json):
        found = _read(log)
        document = info_json(found)
    print_result(document, as_json, lambda: info_table(found))


@log_app.command()
def channels(
    log: LogArgument,
    glob: Annotated[
        list[str] | None, typer.Argument(help="Patterns such as '/joint.*'.", metavar="[GLOB]...")
    ] = None,
    start: FromOption = None,
    stop: ToOption = None,
    as_json: JsonOption = False,
) -> None:
    """Each channel with its type, unit, count and range.

    Example: marsarm log channels run.mcap '/joint.*_rad'
    """
    from ground.telemetry.inspection import select_channels
    from ground.telemetry.tables import channels_json, channels_table

    with _bad_input(as_json):
        read = _read(log, start, stop)
        found = select_channels(read, glob or ())
    print_result(channels_json(read, found), as_json, lambda: channels_table(found))


@log_app.command()
def plot(
    log: LogArgument,
    channel: Annotated[
        list[str],
        typer.Argument(
            help="Such as '/joint.motor_rad', '/joint.motor_rad[2]', '/joint.gap*'.", metavar="CHANNEL..."
        ),
    ],
    out: Annotated[Path, typer.Option(help="The picture.", metavar="FILE.png")],
    start: FromOption = None,
    stop: ToOption = None,
    as_json: JsonOption = False,
) -> None:
    """Draw channels over time, with the events as marks.

    Example: marsarm log plot run.mcap '/joint.motor_rad[2]' /drive.current_limit_A --out joints.png
    """
    from ground.common.files import check_output
    from ground.common.requests import check_distinct_files
    from ground.render.console import pluralize
    from ground.telemetry.figure import save_log_figure
    from ground.telemetry.inspection import select_channels

    with _bad_input(as_json):
        check_distinct_files({"LOG": log, "out": check_output(out, (".png",), "out")})
        read = _read(log, start, stop)
        found = select_channels(read, channel)
        missing = save_log_figure(found, read.evrs, out)
    if missing is not None:
        fail(f"out {out}: not drawn, {missing}", EXIT_BAD_INPUT, as_json)
    document = {"log": str(log), "picture": str(out), "channels": [one.name for one in found]}
    print_result(document, as_json, lambda: print(f"{pluralize(len(found), 'channel')} in {out}"))


@log_app.command()
def export(
    log: LogArgument,
    out: Annotated[
        Path,
        typer.Argument(help="A file for one topic, or a folder for all.", metavar="OUT.parquet|OUT.csv|DIR"),
    ],
    topic: Annotated[
        list[str] | None, typer.Option(help="A topic, such as /joint; may be given again.", metavar="TOPIC")
    ] = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="Files in a folder are CSV, not Parquet.")] = False,
    start: FromOption = None,
    stop: ToOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write topics as tables; Parquet keeps every bit, the units and the log's header.

    Example: marsarm log export run.mcap tables --topic /joint --topic /sensors
    """
    from ground.common.progress_bar import progress_bar
    from ground.telemetry.export import export as carry_out
    from ground.telemetry.tables import export_json, export_table

    with _bad_input(as_json), progress_bar() as progress:
        read = _read(log, start, stop)
        files = carry_out(read, out, topic or (), progress, ".csv" if as_csv else ".parquet")
    print_result(export_json(read, files), as_json, lambda: export_table(read, files))


@log_app.command()
def recover(
    bad: Annotated[Path, typer.Argument(help="A damaged log.", metavar="BAD")],
    good: Annotated[Path, typer.Argument(help="The log to write.", metavar="GOOD.mcap")],
    as_json: JsonOption = False,
) -> None:
    """Write all that is undamaged in a log to a new one, and say what is lost.

    Example: marsarm log recover run.mcap saved.mcap
    """
    from ground.common.progress_bar import progress_bar
    from ground.telemetry.recover import recover as carry_out
    from ground.telemetry.tables import recovery_json, recovery_table

    with _bad_input(as_json), progress_bar() as progress:
        recovered = carry_out(bad, good, progress)
    print_result(recovery_json(bad, good, recovered), as_json, lambda: recovery_table(good, recovered))


@contextmanager
def _bad_input(as_json: bool) -> Iterator[None]:
    """End with a sentence where a file or a request is wrong."""
    from ground.common.files import BadOutput
    from ground.common.requests import BadRequest
    from ground.telemetry.errors import LogError
    from ground.telemetry.figure import TooManyChannels
    from ground.telemetry.inspection import NoSuchChannel

    try:
        yield
    except (LogError, NoSuchChannel, BadOutput, BadRequest, TooManyChannels) as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)


def _read(log: Path, start_s: float | None = None, stop_s: float | None = None) -> "Log":
    """The log between two times; NoSuchChannel where there is nothing."""
    from ground.telemetry.inspection import NoSuchChannel, bound_ns
    from ground.telemetry.lost_messages import trailing_bytes_text
    from ground.telemetry.read import read_log

    read = read_log(log, None, bound_ns("from", start_s), bound_ns("to", stop_s))
    if not read.time_ns and (start_s, stop_s) != (None, None):
        raise NoSuchChannel(f"log {log} has nothing in the time from {start_s} s to {stop_s} s")
    if read.behind:
        print(f"log {log}: {trailing_bytes_text(read.behind)}", file=sys.stderr)
    return read


def import_log(
    table: Annotated[
        Path, typer.Argument(help="Telemetry as .parquet, .csv, .tsv or .txt.", metavar="TABLE")
    ],
    mapping: Annotated[
        Path, typer.Argument(help="Which columns are which channels.", metavar="MAPPING.toml")
    ],
    log: Annotated[Path, typer.Argument(help="The log; what was there is replaced.", metavar="OUT.mcap")],
    as_json: JsonOption = False,
) -> None:
    """Read someone else's telemetry, a table with named columns, into a log like ours.

    docs/import.md says how a mapping is written. Nothing is made up: a channel that is not mapped is not in
    the log, and a packet that lacks a field is kept under /imported/ with those that it has.

    Example: marsarm log import arm.csv arm.toml arm.mcap
    """
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest
    from ground.telemetry.imports.job import ImportRequest, import_json, import_table, import_tables

    try:
        with progress_bar() as progress:
            report = import_table(ImportRequest(table, mapping, log), progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(import_json(report), as_json, lambda: import_tables(report))
