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


def list_errors(ran):
    """List the lines on standard error, but for the progress that a slow machine shows."""
    lines = ran.stderr.splitlines()
    return [line for line in lines if re.fullmatch(r".+ after \d+ s, .+", line) is None]


@pytest.mark.parametrize("words", slow_but([["dictionary", "--json"], ["--help"]], ["--help"]))
def test_a_full_disk_behind_the_output_is_said(words):
    ran = to("> /dev/full", *words)
    assert ran.returncode == 2
    said = "standard output: cannot be written (No space left on device); give it room"
    assert list_errors(ran) == [said]


def test_a_reader_that_has_enough_ends_it_quietly():
    ran = to("| head -c 1 > /dev/null", "dictionary", "--json")
    assert list_errors(ran) == []
    assert ran.returncode in (0, 141)  # 0 where all of it fits into the pipe


@pytest.mark.slow
def test_all_of_it_arrives(tmp_path):
    piped = to("| cat", "dictionary", "--json")
    assert (piped.returncode, list_errors(piped)) == (0, [])
    assert piped.stdout == marsarm(tmp_path, "dictionary", "--json").stdout
