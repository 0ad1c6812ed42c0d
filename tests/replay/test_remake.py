"""Reference runs made anew: the same run is the same, and what differs is printed."""

from io import StringIO

import pytest
from rich.console import Console

from tests.replay.remake import FOLDER, main, make, path_of, tell
from tests.replay.runs import RUNS

(SHORT,) = (run for run in RUNS if run.name == "no-number")


def told(old, new) -> tuple[bool, str]:
    console = Console(file=StringIO(), width=200)
    return tell(SHORT, old, new, console), console.file.getvalue()


def test_a_run_that_is_made_again_is_the_same(tmp_path):
    again = tmp_path / "again"
    again.mkdir()
    differs, said = told(make(SHORT, tmp_path), make(SHORT, again))
    assert not differs
    assert said == "no-number: identical: 81 ticks, 1.3 s, 25 channels\n"


def test_what_differs_is_printed():
    differs, said = told(FOLDER / "fault.mcap", path_of(SHORT))
    assert differs
    assert "recorded is what the file held, replayed the run made anew" in said
    assert "missing  ResolverDisagrees" in said
    assert "header    has another commands" in said


def test_a_name_that_is_no_run_is_refused():
    with pytest.raises(SystemExit, match="jump: no such run; there are joints, contact"):
        main(["jump"])
