"""Define the verb `replay`, and `log` with `info`, `export`, `recover` and `import`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simgap.common.app import VerbApp
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, shown, verb

if TYPE_CHECKING:
    from marsarm.telemetry.read import Log

LogArgument = Annotated[Path, typer.Argument(help="A telemetry log (MCAP).", metavar="LOG")]
FromOption = Annotated[float | None, typer.Option("--from", help="First log time, in seconds.", metavar="S")]
ToOption = Annotated[
    float | None, typer.Option("--to", help="Log time to end before, in seconds.", metavar="S")
]

log_app = VerbApp(
    help="Inspect, export, recover and import telemetry logs.\n\nExample: marsarm log info run.mcap"
)


@log_app.command()
@verb
def info(
    log: LogArgument,
    glob: Annotated[
        list[str] | None, typer.Argument(help="Patterns of channels such as '/joint.*'.", metavar="[GLOB]...")
    ] = None,
    start: FromOption = None,
    stop: ToOption = None,
) -> VerbResult:
    """Summarize a log: versions, duration, topics, events, and whether it is complete.

    With patterns, list the channels that match, with type, unit, count and range; '*' lists all.

    Example: marsarm log info run.mcap '/joint.*_rad'
    """
    from marsarm.telemetry.tables import channels_document, channels_parts, info_document, info_parts

    read = _read(log, start, stop)
    if not glob:
        return shown(info_document(read), info_parts(read))
    from marsarm.telemetry.inspection import select_channels

    selected = select_channels(read, glob)
    return shown(channels_document(read, selected), channels_parts(read, selected))


@log_app.command()
@verb
def export(
    progress: Progress,
    log: LogArgument,
    out: Annotated[Path, typer.Argument(help="A folder, new or not.", metavar="DIR")],
    topic: Annotated[
        list[str] | None, typer.Option(help="A topic, such as /joint; repeatable.", metavar="TOPIC")
    ] = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="Write CSV files, not Parquet.")] = False,
    start: FromOption = None,
    stop: ToOption = None,
) -> VerbResult:
    """Write topics as tables; Parquet keeps exact values, units and the header of the log.

    Example: marsarm log export run.mcap tables --topic /joint --topic /sensors
    """
    from marsarm.telemetry.export import export
    from marsarm.telemetry.tables import export_document, export_parts

    read = _read(log, start, stop)
    files = export(read, out, topic or (), progress, ".csv" if as_csv else ".parquet")
    return shown(export_document(read, files), export_parts(read, files))


@log_app.command()
@verb
def recover(
    progress: Progress,
    bad: Annotated[Path, typer.Argument(help="A damaged log.", metavar="BAD")],
    good: Annotated[Path, typer.Argument(help="The log to write.", metavar="GOOD.mcap")],
) -> VerbResult:
    """Copy all undamaged messages of a log to a new one, and list what is lost.

    Example: marsarm log recover run.mcap saved.mcap
    """
    from marsarm.telemetry.recover import recover
    from marsarm.telemetry.tables import recovery_document, recovery_parts

    recovered = recover(bad, good, progress)
    return shown(recovery_document(bad, good, recovered), recovery_parts(good, recovered))


@log_app.command("import")
@verb
def import_log(
    progress: Progress,
    table: Annotated[
        Path, typer.Argument(help="Telemetry as .parquet, .csv, .tsv, .txt, .npz or .mcap.", metavar="TABLE")
    ],
    mapping: Annotated[Path, typer.Argument(help="The channel of each column.", metavar="MAPPING.toml")],
    log: Annotated[
        Path, typer.Argument(help="The log to write; an existing file is replaced.", metavar="OUT.mcap")
    ],
) -> VerbResult:
    """Convert sensors and drive of another system, a table with named columns, into a log for `diagnose`.

    docs/logs.md describes the mapping. Missing values are not invented.

    Example: marsarm log import arm.csv arm.toml arm.mcap
    """
    from marsarm.telemetry.import_table import import_document, import_parts, import_table

    made = import_table(table, mapping, log, progress)
    return shown(import_document(log, made), import_parts(log, made))


def _read(log: Path, start_s: float | None, stop_s: float | None) -> "Log":
    """Read a log between two times; BadRequest if it has no message there."""
    from marsarm.telemetry.format import trailing_bytes_text
    from marsarm.telemetry.inspection import bound_ns
    from marsarm.telemetry.read import read_log

    start_ns, stop_ns = bound_ns("from", start_s), bound_ns("to", stop_s)
    if start_ns is not None and stop_ns is not None and start_ns >= stop_ns:
        raise BadRequest(f"from: {start_s} s is not before --to {stop_s} s; give a span of log time")
    read = read_log(log, None, start_ns, stop_ns)
    if not read.time_ns and (start_s, stop_s) != (None, None):
        ends = {"from": start_s, "to": stop_s}
        span = " ".join(f"{name} {time_s} s" for name, time_s in ends.items() if time_s is not None)
        raise BadRequest(f"log {log} has nothing in the time {span}")
    if read.end_note:
        print(f"log {log}: {read.end_note}", file=sys.stderr)
    if read.trailing_bytes:
        print(f"log {log}: {trailing_bytes_text(read.trailing_bytes)}", file=sys.stderr)
    return read


@verb
def replay(
    progress: Progress,
    log: LogArgument,
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
    from marsarm.replaying.replay import ReplayRequest, replay, replay_document, replay_parts

    report = replay(ReplayRequest(log, channel, params), progress)
    return shown(replay_document(report), replay_parts(report), report.differences.identical)
