"""Command lines in this process, which take no second to import, and what they must not say or leave."""

import os
import re
import signal
import subprocess
import sys
import warnings
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from io import BytesIO, TextIOWrapper
from unittest.mock import patch

import typer

from simgap.__main__ import start
from simgap.common import progress
from simgap.common.interruption import END_SIGNALS

Ran = subprocess.CompletedProcess[str]
LIBRARY_WORDS = re.compile(
    r"\[Errno|Input should|Traceback|[ (]b['\"]|codec|ArrowInvalid|object at 0x|pydantic"
)
"""Words of Python and its libraries, which tell a user nothing."""

get_command = cache(typer.main.get_command)
"""A program makes its verbs from their functions once."""


def run_simgap(folder, *words):
    """Run `simgap` with these words in a folder, until it exits."""
    return call(start, folder, *words)


def call(program, folder, *words):
    """Run a program in this process until it exits.

    Args:
        program: Function that reads `sys.argv` and ends with `SystemExit`.
        folder: Working directory.
        *words: Arguments of the program.
    """
    stdout, stderr = (TextIOWrapper(BytesIO(), "utf-8", write_through=True) for _ in range(2))
    status: str | int | None = None
    with (
        handlers_kept(),
        chdir(folder),
        patch.object(sys, "argv", ["-", *words]),
        patch.dict(os.environ),
        patch.object(progress, "WAITS_S", (60.0,)),  # what a line says depends on the load of the machine
        patch.object(progress, "keep_run", lambda *_: None),  # a user's next run is not like a test
        patch.object(typer.main, "get_command", get_command),
        redirect_stdout(stdout),
        redirect_stderr(stderr),
        warnings.catch_warnings(),
    ):
        try:
            program()
        except SystemExit as ended:
            status = ended.code
    printed, errors = (stream.buffer.getvalue().decode() for stream in (stdout, stderr))
    return subprocess.CompletedProcess(words, status or 0, printed, errors)


def run_python(folder, *words, timeout_s=1200.0, **environment):
    """Run Python in a process of its own, with other values of some variables of the environment."""
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=os.environ | environment, timeout=timeout_s,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@contextmanager
def handlers_kept():
    """Put back how signals end this process, after a block that changes it."""
    handlers = {number: signal.getsignal(number) for number in END_SIGNALS}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def snapshot(folder):
    """Return size and time of change of every file."""
    found = ((path, path.lstat()) for path in sorted(folder.rglob("*")) if "__pycache__" not in path.parts)
    return {str(path): (about.st_size, about.st_mtime_ns) for path, about in found}
