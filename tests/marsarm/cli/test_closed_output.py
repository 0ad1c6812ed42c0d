"""Tests of output to a full disk or a closed pipe."""

import re
import subprocess
import sys

import pytest

from helpers.marks import slow_but
from tests.marsarm.command import ROOT, marsarm

MAIN = "from marsarm.__main__ import start; start()"


def to(target, *words):
    return subprocess.run(
        ["bash", "-c", f'set -o pipefail; "$@" {target}', "-", sys.executable, "-c", MAIN, *words],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


def is_progress(line):
    """Return whether a line is one of those that a slow machine shows."""
    return re.fullmatch(r".+ after \d+ s, .+", line) is not None


@pytest.mark.parametrize("words", slow_but([["dictionary", "--json"], ["--help"]], ["--help"]))
def test_a_full_disk_behind_the_output_is_said(words):
    ran = to("> /dev/full", *words)
    assert ran.returncode == 2
    assert ran.stderr == "standard output: cannot be written (No space left on device); give it room\n"


def test_a_reader_that_has_enough_ends_it_quietly():
    ran = to("| head -c 1 > /dev/null", "dictionary", "--json")
    assert [line for line in ran.stderr.splitlines() if not is_progress(line)] == []
    assert ran.returncode in (0, 141)  # 0 where all of it fits into the pipe


@pytest.mark.slow
def test_all_of_it_arrives(tmp_path):
    piped = to("| cat", "dictionary", "--json")
    assert piped.returncode == 0
    assert all(map(is_progress, piped.stderr.splitlines()))
    assert piped.stdout == marsarm(tmp_path, "dictionary", "--json").stdout
