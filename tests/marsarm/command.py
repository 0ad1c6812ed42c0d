"""Helpers that run the command line: in this process, or in one of its own as a user does."""

import os
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from io import BytesIO, TextIOWrapper
from pathlib import Path
from unittest.mock import patch

from marsarm.__main__ import start
from simgap.common.interruption import END_SIGNALS

ROOT = Path(__file__).resolve().parents[2]
Ran = subprocess.CompletedProcess[str]
SHORT_RUN = """\
title = "A short move"
summary = "Turn the turret a little."
start = "ready"

[[command]]
type = "MOVE_JOINT"
joint = "turret"
angle_deg = 95

[[check]]
type = "done"
"""
"""A scenario of two seconds."""


def marsarm(folder: Path, *words: str) -> Ran:
    """Run the command line in this process, without the second that a new one takes to import."""
    return call(start, folder, *words)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file of this process, and of those that it starts, grow beyond this size in bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def call(program: Callable[[], object], folder: Path, *words: str) -> Ran:
    """Run a program in this process until it exits.

    Args:
        program: Function that reads `sys.argv` and ends with `SystemExit`.
        folder: Working directory.
        *words: Arguments of the program.
    """
    stdout, stderr = (TextIOWrapper(BytesIO(), "utf-8", write_through=True) for _ in range(2))
    handlers = {number: signal.getsignal(number) for number in END_SIGNALS}
    status: str | int | None = None
    with (
        chdir(folder),
        patch.object(sys, "argv", ["-", *words]),
        patch.dict(os.environ),
        redirect_stdout(stdout),
        redirect_stderr(stderr),
        warnings.catch_warnings(),
    ):
        try:
            program()
        except SystemExit as ended:
            status = ended.code
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    printed, errors = (stream.buffer.getvalue().decode() for stream in (stdout, stderr))
    return subprocess.CompletedProcess(words, status or 0, printed, errors)


def marsarm_process(folder: Path, *words: str, **variables: str) -> Ran:
    """Run the command line of this tree, not an installed one, in a process of its own.

    Args:
        folder: Working directory.
        *words: Arguments of `marsarm`.
        **variables: Environment variables.
    """
    command = [sys.executable, "-c", "from marsarm.__main__ import start; start()", *words]
    env = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        command, cwd=folder, env=env, capture_output=True, text=True, timeout=3000, check=False
    )
