"""Helpers that run the command line: in this process, or in one of its own as a user does."""

import json
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from helpers.command import Ran, call
from marsarm.__main__ import start

ROOT = Path(__file__).resolve().parents[2]
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


def marsarm_json(folder: Path, *words: str, status: int = 0) -> Any:
    """Return the document of a command line that must end with this status."""
    done = marsarm(folder, *words, "--json")
    assert done.returncode == status, done.stderr
    return json.loads(done.stdout)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file of this process, and of those that it starts, grow beyond this size in bytes.

    Python does not notice that a file of bytecode is cut, so it writes none.
    """
    (soft, hard), writes_none = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = writes_none
