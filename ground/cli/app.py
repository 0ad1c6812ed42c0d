"""Assemble the command line `marsarm` and write its output.

Exit status: 0 done; 1 a bug; 2 bad input; 3 the arm refused or faulted and is safe; 141 the reader of the
output is closed.
"""

import json
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, TextIOWrapper
from typing import Final, NoReturn

import typer

from ground.cli.accuracy import budget, monte_carlo
from ground.cli.arm import arm_app
from ground.cli.calibrate import calibrate, calibrate_serial
from ground.cli.diagnosis import diagnose, gap_app
from ground.cli.dictionary import dictionary, effects
from ground.cli.ik import ik, reach
from ground.cli.log import log_app, replay
from ground.cli.runs import hardstop, place, run, scenarios
from ground.cli.verb import EXIT_BAD_INPUT

EXIT_PIPE_CLOSED: Final = 128 + signal.SIGPIPE
"""Exit status of a program whose reader has closed the pipe, as `head` does."""
GL_OFF: Final = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL that turn OpenGL off in mujoco."""

app = typer.Typer(
    name="marsarm",
    help="Control of the Curiosity rover's arm, a MuJoCo plant for it, and ground tools.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(place)
app.command()(ik)
app.command()(reach)
app.command()(hardstop)
app.command()(run)
app.command()(scenarios)
app.command()(replay)
app.command()(dictionary)
app.command()(effects)
app.add_typer(log_app, name="log")
app.add_typer(gap_app, name="gap")
app.add_typer(arm_app, name="arm")
app.command()(budget)
app.command("monte-carlo")(monte_carlo)
app.command()(calibrate)
app.command("calibrate-serial")(calibrate_serial)
app.command()(diagnose)


def main() -> None:
    """Run the command `marsarm`."""
    _drop_gl_settings()
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            # An exception unwinds the stack, so that temporary files are deleted.
            signal.signal(number, lambda received, _: sys.exit(128 + received))
    warnings.simplefilter("ignore", RuntimeWarning)  # warnings of numpy are for developers
    with buffer_stdout():
        _run()


def _drop_gl_settings() -> None:
    """Remove MUJOCO_GL from the environment, unless it turns OpenGL off.

    A value that mujoco cannot serve stops its import. Pictures do not need the variable.
    """
    if os.environ.get("MUJOCO_GL", "").lower().strip() not in GL_OFF:
        os.environ.pop("MUJOCO_GL", None)


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


@contextmanager
def buffer_stdout() -> Iterator[None]:
    """Buffer the standard output and write it when the block ends, unless it is a terminal.

    A full disk then gives one error message, and a closed pipe gives none.
    """
    stdout = sys.stdout
    if stdout is None or stdout.isatty():
        yield
        return
    buffer = BytesIO()
    sys.stdout = TextIOWrapper(buffer, stdout.encoding, stdout.errors, write_through=True)
    try:
        yield
    finally:
        printed = buffer.getvalue()
        sys.stdout = stdout
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
    """Redirect the standard output to the null device: the interpreter flushes it once more on exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
