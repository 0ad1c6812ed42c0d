"""Errors of `gap record` and of the campaign of blind cases."""

import json
from pathlib import Path
from typing import Any

import pytest

from simgap.common.errors import BadRequest
from tests.marsarm.command import marsarm
from validation.campaigns import Context
from validation.cases.arm import campaign


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("record", "--out", "other"), "out other: is there and is no empty folder; name a new or empty one"),
        (("record", "--out", "no/logs"), "there is no folder no"),
        (("record", "--out", "nothing"), "a link to nowhere/x, which is not there"),
        (("record", "--out", "logs", "--effect", "rusty-gear"), "'rusty-gear' is not known"),
        (
            ("record", "--out", "logs", "--sessions", "poses-levl-*"),
            "sessions: nothing is called 'poses-levl-*'",
        ),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_is_written(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    (tmp_path / "nothing").symlink_to("nowhere/x")
    done = marsarm(tmp_path, "gap", *words, "--json")
    assert done.returncode == 2
    assert said in done.stderr
    assert said in json.loads(done.stdout)["error"]
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "nothing", "other"]


@pytest.mark.parametrize(
    ("out", "sizes", "said"),
    [
        ("b", {"cases": 0}, "cases: 0 is not within 1 .. 1000"),
        ("b", {"step": "dance"}, "step: dance is none of all, make, solve, score"),
        ("no/b", {}, "there is no folder .*no"),
        ("nothing", {}, "a link to nowhere/x, which is not there"),
        ("other", {}, "holds something else"),
        ("other/file", {}, "this is a file"),
        ("other", {"step": "solve"}, "no folder of cases"),
        ("other", {"step": "score"}, "no folder of cases"),
    ],
)
def test_cases_that_cannot_be_made_are_refused_and_nothing_is_written(
    tmp_path: Path, out: str, sizes: dict[str, Any], said: str
) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    (tmp_path / "nothing").symlink_to("nowhere/x")
    with pytest.raises(BadRequest, match=said):
        campaign(Context(out=tmp_path / out), **sizes)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "nothing", "other"]
