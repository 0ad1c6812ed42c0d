"""Tests of recording reference runs again: an identical run is recognised, and differences are printed."""

from io import StringIO

import pytest
from rich.console import Console

from tests.replay.remake import FOLDER, main, make, path_of, tell
from tests.replay.runs import RUNS

(SHORT,) = (run for run in RUNS if run.name == "no-number")


def print_differences(old, new) -> tuple[bool, str]:
    console = Console(file=StringIO(), width=200)
    return tell(SHORT, old, new, console), console.file.getvalue()


def test_a_run_that_is_made_again_is_the_same(tmp_path):
    again = tmp_path / "again"
    again.mkdir()
    differs, printed = print_differences(make(SHORT, tmp_path), make(SHORT, again))
    assert not differs
    assert printed == "no-number: identical: 81 ticks, 1.3 s, 26 channels\n"


def test_what_differs_is_printed():
    differs, printed = print_differences(FOLDER / "fault.mcap", path_of(SHORT))
    assert differs
    assert "recorded is what the file held, replayed the run made anew" in printed
    assert "missing  ResolverDisagrees" in printed
    assert "header    has another commands" in printed


def test_a_name_that_is_no_run_is_refused():
    with pytest.raises(SystemExit, match="jump: no such run; there are joints, contact"):
        main(["jump"])
