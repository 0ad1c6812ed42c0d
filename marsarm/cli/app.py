"""Assemble the command line `marsarm` and write its output.

Exit status: 0 done; 1 a bug; 2 bad input; 3 the arm refused or faulted and is safe; 130 interrupted by
Ctrl-C, 143 by SIGTERM; 141 the reader of the output is closed.
"""

import json
import os
import sys
import warnings
from importlib.metadata import version
from typing import Annotated, Final, NoReturn

import typer

from marsarm.cli.analysis import arm, budget, calibrate, dictionary, ik, monte_carlo, reach
from marsarm.cli.calibrate_serial import calibrate_serial
from marsarm.cli.diagnosis import diagnose, gap_app
from marsarm.cli.log import log_app, replay
from marsarm.cli.robot import robot_app
from marsarm.cli.runs import hardstop, place, run, view
from simgap.common.verb import VerbCommand, buffer_stdout

GL_OFF: Final = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL that turn OpenGL off in mujoco."""

app = typer.Typer(
    name="marsarm",
    help="Control of the arms of Curiosity and like rovers, a MuJoCo plant for them, and ground tools.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(is_asked: bool) -> None:
    if is_asked:
        print(f"marsarm {version('marsarm')}")
        raise typer.Exit


VersionOption = Annotated[
    bool,
    typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True),
]


@app.callback()
def _options_without_verb(_: VersionOption = False) -> None:
    """Declare the options that stand without a verb."""


app.command()(place)
app.command(cls=VerbCommand)(ik)
app.command(cls=VerbCommand)(reach)
app.command()(hardstop)
app.command()(run)
app.command()(view)
app.command()(replay)
app.command()(dictionary)
app.add_typer(log_app, name="log")
app.add_typer(gap_app, name="gap")
app.add_typer(robot_app, name="robot")
app.command()(arm)
app.command()(budget)
app.command("monte-carlo", cls=VerbCommand)(monte_carlo)
app.command()(calibrate)
app.command("calibrate-serial")(calibrate_serial)
app.command(cls=VerbCommand)(diagnose)


def main() -> None:
    """Run the command `marsarm`; `marsarm.__main__` calls this and reports an interruption."""
    _drop_gl_settings()
    _do_without_glfw()
    warnings.simplefilter("ignore", RuntimeWarning)  # warnings of numpy are for developers
    with buffer_stdout():
        _run()


def _drop_gl_settings() -> None:
    """Remove MUJOCO_GL from the environment, unless it turns OpenGL off.

    A value that mujoco cannot serve stops its import. Pictures do not need the variable.
    """
    if os.environ.get("MUJOCO_GL", "").lower().strip() not in GL_OFF:
        os.environ.pop("MUJOCO_GL", None)


def _do_without_glfw() -> None:
    """Let mujoco do without glfw on Linux, where pictures need no window.

    The import of glfw starts Python once more to look for its library. This takes time, and Ctrl-C would
    make that process print an error.
    """
    if sys.platform == "linux":
        sys.modules["glfw"] = None  # type: ignore[assignment]


def _run() -> NoReturn:
    try:
        status = app(prog_name="marsarm", standalone_mode=False)
    except typer.TyperException as error:
        message = _describe_usage_error(error)
        if message:
            if "--json" in sys.argv:
                print(json.dumps({"error": message}))
            print(message, file=sys.stderr)
        status = error.exit_code
    sys.exit(status)


def _describe_usage_error(error: typer.TyperException) -> str:
    """Return one sentence about wrong usage; nothing if typer has printed the help instead."""
    message = error.format_message().rstrip(".")
    parameter = getattr(error, "param", None)
    if parameter is not None and "Input should be" in message:  # the words of a library
        number = "whole number" if "integer" in message else "number"
        plural = "s" if parameter.nargs > 1 else ""
        message = f"{parameter.get_error_hint()}: takes {parameter.nargs} {number}{plural}"
    context = getattr(error, "ctx", None)
    advice = "" if context is None else f"; `{context.command_path} --help` lists what there is"
    return f"{message}{advice}" if message else ""
