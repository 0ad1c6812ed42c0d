"""What becomes of the output of a command when nobody takes it."""

import json
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, NoReturn

import typer

from ground.cli.budget import budget
from ground.cli.calibrate import calibrate, calibrate_serial
from ground.cli.diagnose import diagnose
from ground.cli.dictionary import dictionary, effects
from ground.cli.gap import gap_app
from ground.cli.hardstop import hardstop
from ground.cli.ik import ik, reach
from ground.cli.log import import_log, log_app
from ground.cli.monte_carlo import monte_carlo
from ground.cli.options import (
    EXIT_ARM_SAFE,
    EXIT_BAD_INPUT,
    ArmOption,
    DiskOption,
    EffectOption,
    JsonOption,
    ParamsOption,
    PitchOption,
    RollOption,
    SeedOption,
    Vector,
    fail,
    print_result,
)
from ground.cli.replay import replay
from ground.cli.run import run, scenarios

if TYPE_CHECKING:
    from ground.runs.place import PlaceReport

GL_OFF = ("disable", "disabled", "off", "false", "0")
"""The values of MUJOCO_GL that mujoco takes for no OpenGL."""

app = typer.Typer(
    name="marsarm",
    help="Control of the Curiosity rover's arm, a MuJoCo plant for it, and the ground tools around it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def place(
    tool: Annotated[str, typer.Option(help="apxs, mahli, drt or drill.", metavar="TOOL")] = "apxs",
    target: Annotated[
        Vector, typer.Option(help="Point on the surface, RNAV, in metres.", metavar="X Y Z")
    ] = (
        2.05,
        0.1,
        -0.25,
    ),
    normal: Annotated[
        Vector, typer.Option(help="Direction out of the surface, RNAV.", metavar="NX NY NZ")
    ] = (-0.5, 0.1, -0.85),
    tilt_roll: RollOption = 0.0,
    tilt_pitch: PitchOption = 0.0,
    arm: ArmOption = "nominal",
    seed: SeedOption = 0,
    params: ParamsOption = None,
    effect: EffectOption = None,
    surface: Annotated[
        bool, typer.Option("--surface/--no-surface", help="Whether the rock is there at all.")
    ] = True,
    log: Annotated[
        Path | None, typer.Option(help="Write a telemetry log (MCAP).", metavar="FILE.mcap")
    ] = None,
    when_disk_full: DiskOption = "go-on",
    picture: Annotated[Path, typer.Option(help="Draw the arm in contact.", metavar="FILE.png")] = Path(
        "place.png"
    ),
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw no picture.")] = False,
    movie: Annotated[Path | None, typer.Option(help="Draw the whole run.", metavar="FILE.gif")] = None,
    as_json: JsonOption = False,
) -> None:
    """Unstow, put an instrument on a rock, and retract.

    RNAV is x forward, y right, z down, from the ground below the rover: a rock 0.25 m high has z = -0.25.

    Example: marsarm place --tool mahli --target 2.1 0 -0.2 --normal -0.4 0 -1 --tilt-pitch 10
    """
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest
    from ground.runs.execution import RunFiles
    from ground.runs.place import PlaceRequest
    from ground.runs.place import place as carry_out
    from ground.runs.tables import place_json, place_table

    request = PlaceRequest(
        tool=tool,
        target_m=target,
        normal=normal,
        tilt_roll_deg=tilt_roll,
        tilt_pitch_deg=tilt_pitch,
        arm=arm,
        seed=seed,
        params=params,
        effects=tuple(effect or ()),
        has_surface=surface,
        files=RunFiles(log, None if no_picture else picture, movie, when_disk_full),
    )
    try:
        with progress_bar() as progress:
            report = carry_out(request, progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(place_json(report), as_json, lambda: place_table(report))
    _finish(report)


app.command()(ik)
app.command()(reach)
app.command()(hardstop)
app.command()(run)
app.command()(scenarios)
app.command()(replay)
app.command()(dictionary)
app.command()(effects)
log_app.command("import")(import_log)
app.add_typer(log_app, name="log")
app.add_typer(gap_app, name="gap")
app.command()(budget)
app.command("monte-carlo")(monte_carlo)
app.command()(calibrate)
app.command("calibrate-serial")(calibrate_serial)
app.command()(diagnose)


def _finish(report: "PlaceReport") -> None:
    if report.result.outcome != "done":
        raise typer.Exit(EXIT_ARM_SAFE)


def main() -> None:
    """The entry point of the command `marsarm`."""
    _drop_gl_settings()
    for ended in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(ended) is not signal.SIG_IGN:  # as nohup has it
            signal.signal(ended, lambda number, _: sys.exit(128 + number))  # so that half-written files go
    warnings.simplefilter("ignore", RuntimeWarning)  # numpy's are for developers; users get sentences
    with buffer_stdout():
        _run()


def _run() -> NoReturn:
    if "--json" not in sys.argv:
        app()
    try:
        status = app(standalone_mode=False)
    except typer.TyperException as error:  # wrong usage, which typer would print in a box
        message = error.format_message()
        print(json.dumps({"error": message}))
        print(message, file=sys.stderr)
        status = error.exit_code
    sys.exit(status)


def _drop_gl_settings() -> None:
    """Before mujoco is imported: a MUJOCO_GL that it cannot serve stops the import. Pictures need none."""
    if os.environ.get("MUJOCO_GL", "").lower().strip() not in GL_OFF:
        os.environ.pop("MUJOCO_GL", None)


EXIT_PIPE_CLOSED: Final = 128 + signal.SIGPIPE
"""The status of a program whose reader has gone, as `head` does."""


@contextmanager
def buffer_stdout() -> Iterator[None]:
    """Keep what is printed and write it at the end: a full disk ends with a sentence, a gone reader quietly.

    A terminal gets it at once.
    """
    real = sys.stdout
    if real is None or real.isatty():
        yield
        return
    kept = BytesIO()
    sys.stdout = TextIOWrapper(kept, real.encoding, real.errors, write_through=True)
    try:
        yield
    finally:
        printed = kept.getvalue()
        sys.stdout = real
        _write(printed)


def _write(printed: bytes) -> None:
    try:
        sys.stdout.buffer.write(printed)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()
        sys.exit(EXIT_PIPE_CLOSED)
    except OSError as error:
        _discard_stdout()
        print(f"standard output: cannot be written ({error.strerror}); give it room", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)


def _discard_stdout() -> None:
    """Let the interpreter not try again when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
