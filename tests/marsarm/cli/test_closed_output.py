"""Tests of output to a full disk or a closed pipe."""

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


@pytest.mark.parametrize("words", slow_but([["dictionary", "--json"], ["--help"]], ["--help"]))
def test_a_full_disk_behind_the_output_is_said(words):
    ran = to("> /dev/full", *words)
    assert ran.returncode == 2
    assert ran.stderr == "standard output: cannot be written (No space left on device); give it room\n"


def test_a_reader_that_has_enough_ends_it_quietly():
    ran = to("| head -c 1 > /dev/null", "dictionary", "--json")
    assert ran.stderr == ""
    assert ran.returncode in (0, 141)  # 0 where all of it fits into the pipe


@pytest.mark.slow
def test_all_of_it_arrives(tmp_path):
    piped = to("| cat", "dictionary", "--json")
    assert (piped.returncode, piped.stderr) == (0, "")
    assert piped.stdout == marsarm(tmp_path, "dictionary", "--json").stdout
