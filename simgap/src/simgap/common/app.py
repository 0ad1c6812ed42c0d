"""Command line of a program: its version, its exit status, and its standard output.

The output is buffered, so that a full disk gives one error and a closed pipe none.
"""

import gc
import inspect
import json
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from io import BytesIO, TextIOWrapper
from itertools import pairwise
from typing import Annotated, Any, Final, NoReturn, TextIO

import typer
from typer import _completion_classes
from typer.core import TyperCommand
from typer.main import get_command_from_info
from typer.models import CommandInfo

from simgap.common.options import CLUSTER_HERE

NEW_OBJECTS: Final = 50_000
"""New objects before a search for garbage. With the 700 of Python, searches take a tenth of the start."""
EXIT_BAD_INPUT: Final = 2
LEAST_LIKENESS: Final = 0.75
"""Least ratio of `difflib` for an option to be suggested: `--tol` has 0.91 to `--tool`, `--foo` 0.73."""
ADDRESS: Final = re.compile(rf"{CLUSTER_HERE}|\S+:[0-9]+")
"""Value of the option `--cluster`."""
WIDEST: Final = 110
"""Most columns of a help text, as of the lines of the documents."""
EXIT_PIPE_CLOSED: Final = 128 + signal.SIGPIPE
"""Exit status of a program whose reader has closed the pipe, as `head` does."""


class BufferedStdout(TextIOWrapper):
    """Text that is kept until it is released to the standard output."""

    def __init__(self, stdout: TextIO) -> None:
        self._kept = BytesIO()
        super().__init__(self._kept, stdout.encoding, stdout.errors, write_through=True)
        self._stdout = stdout

    def release(self) -> None:
        """Write what was kept; end the command if that is impossible."""
        printed = self._kept.getvalue()
        self._kept.seek(0)
        self._kept.truncate()
        _write(self._stdout, printed)


@contextmanager
def buffer_stdout() -> Iterator[None]:
    """Buffer the standard output and write it when the block ends, unless it is a terminal."""
    stdout = sys.stdout
    if stdout is None or stdout.isatty():
        yield
        return
    buffered = BufferedStdout(stdout)
    sys.stdout = buffered
    try:
        yield
    finally:
        sys.stdout = stdout
        buffered.release()


def release_stdout() -> None:
    """Write what was printed so far, for a program that reads it while the command continues."""
    if isinstance(sys.stdout, BufferedStdout):
        sys.stdout.release()


def _write(stdout: TextIO, printed: bytes) -> None:
    try:
        stdout.buffer.write(printed)
        stdout.flush()
    except BrokenPipeError:
        _discard(stdout)
        sys.exit(EXIT_PIPE_CLOSED)
    except OSError as error:
        _discard(stdout)
        print(f"standard output: cannot be written ({error.strerror}); give it room", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)


def _discard(stdout: TextIO) -> None:
    """Redirect the standard output to the null device: the interpreter flushes it once more on exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())


class VerbCommand(TyperCommand):
    """Command whose options are read when it is chosen: those of all verbs take a third of `--help`."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Parse the words of the command line; typer does not know that `--cluster` may stand alone."""
        self.read_options()
        return super().make_context(info_name, list(give_address(args)), parent, **extra)

    def read_options(self) -> None:
        """Read the options of the verb; those of a command that is no verb are there."""
        read = getattr(inspect.unwrap(self.callback), "read_options", None) if self.callback else None
        if read is not None:
            info = CommandInfo(callback=read())
            whole = get_command_from_info(info, pretty_exceptions_short=False, rich_markup_mode=None)
            self.callback, self.params = whole.callback, whole.params


class VerbApp(typer.Typer):
    """Command line, or a part of it, whose commands are verbs; with rich, `--help` takes twice the time."""

    def __init__(self, help: str, **settings: Any) -> None:
        settings |= {"short_help": _summary(help), "rich_markup_mode": None, "no_args_is_help": True}
        super().__init__(help=help, **settings)

    def command(self, name: str | None = None, **_: Any) -> Callable[..., Any]:
        """Make a command of a verb."""

        def add(work: Callable[..., Any]) -> Callable[..., Any]:
            short_help = _summary(work.__doc__ or "")
            return super(VerbApp, self).command(name, cls=VerbCommand, short_help=short_help)(work)

        return add


def _summary(about: str) -> str:
    """Return the first paragraph of a help text: a sentence that a list of verbs shows whole."""
    return " ".join(about.partition("\n\n")[0].split())


def give_address(words: Sequence[str]) -> Iterator[str]:
    """Put CLUSTER_HERE after an option `--cluster` that no HOST:PORT follows."""
    for word, following in pairwise((*words, "")):
        yield word
        if word == "--cluster" and not ADDRESS.fullmatch(following):
            yield CLUSTER_HERE


def make_app(program: str, about: str) -> VerbApp:
    """Make the command line of a program, with its version and no verb yet."""
    app = VerbApp(
        name=program,
        help=about,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDEST},
    )

    def print_version(is_asked: bool) -> None:
        if is_asked:
            from importlib.metadata import version  # takes a tenth of the time of `--help` to load

            print(f"{program} {version(program)}")
            raise typer.Exit

    help_text = "Print the version and exit."
    option = typer.Option("--version", help=help_text, callback=print_version, is_eager=True)

    @app.callback()
    def options_without_verb(_: Annotated[bool, option] = False) -> None:
        """Declare the options that stand without a verb."""

    return app


def run_app(app: typer.Typer, program: str) -> None:
    """Run a command line, and exit with its status.

    0 done; 1 a bug; 2 bad input; 3 not done, and nothing is wrong; 130 interrupted by Ctrl-C, 143 by SIGTERM;
    141 the reader of the output is closed.
    """
    gc.set_threshold(NEW_OBJECTS)
    os.environ["MUJOCO_GL"] = "disable"  # pictures are ray cast; OpenGL may be missing, block or crash
    # typer takes brackets for markup, and wraps
    _completion_classes._sanitize_help_text = lambda text: " ".join(text.split())
    warnings.simplefilter("ignore", RuntimeWarning)  # warnings of numpy are for developers
    with buffer_stdout():
        _run(app, program)


def _run(app: typer.Typer, program: str) -> NoReturn:
    try:
        status = app(prog_name=program, standalone_mode=False)
    except typer.TyperException as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # a verb is missing
            print(error.message)
        else:
            message = _describe_usage_error(error)
            if "--json" in sys.argv:
                print(json.dumps({"error": message}))
            print(message, file=sys.stderr)
        status = error.exit_code
    sys.exit(status)


def _describe_usage_error(error: typer.TyperException) -> str:
    """Return one sentence about wrong usage."""
    message = error.format_message().rstrip(".")
    if hasattr(error, "possibilities"):  # of which any short word is like `--json`
        wrong: str = vars(error)["option_name"]
        alike = get_close_matches(wrong, error.possibilities or (), 1, LEAST_LIKENESS)
        message = f"No such option: {wrong}" + "".join(f"; did you mean {name}?" for name in alike)
    parameter = getattr(error, "param", None)
    if parameter is not None and "Input should be" in message:  # the words of a library
        number = "whole number" if "integer" in message else "number"
        plural = "s" if parameter.nargs > 1 else ""
        message = f"{parameter.get_error_hint()}: takes {parameter.nargs} {number}{plural}"
    context = getattr(error, "ctx", None)
    advice = "" if context is None else f"; `{context.command_path} --help` lists what there is"
    return f"{message}{advice}"
