"""Errors of `gap record` and of `python -m validation.blind`."""

import json
from pathlib import Path

import pytest

from tests.marsarm.command import Ran, call, marsarm
from validation.blind.__main__ import app as blind_app


def blind(folder: Path, *words: str) -> Ran:
    """Run `python -m validation.blind` in a folder, in this process."""
    return call(blind_app, folder, *words, "--json")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("record", "--out", "other"), "out other: is there and is no empty folder; name a new or empty one"),
        (("record", "--out", "no/logs"), "there is no folder no"),
        (("record", "--out", "o" * 300), "cannot be written (File name too long)"),
        (("record", "--out", "nothing"), "a link to nowhere/x, which is not there"),
        (("record", "--out", "logs", "--effect", "rusty-gear"), "'rusty-gear' is not known"),
        (
            ("record", "--out", "logs", "--sessions", "poses-levl-*"),
            "sessions: nothing is called 'poses-levl-*'",
        ),
        (("make", "--cases", "0", "--out", "b"), "cases: 0 is not within 1 .. 1000"),
        (("make", "--cases", "-3", "--out", "b"), "cases: -3 is not within"),
        (("make", "--seed", "-1", "--out", "b"), "seed: -1 is below 0"),
        (("make", "--jobs", "0", "--out", "b"), "jobs: 0 is not 1 or more"),
        (("make", "--out", "no/b"), "there is no folder no"),
        (("make", "--out", "b" * 300), "cannot be written (File name too long)"),
        (("make", "--out", "nothing"), "a link to nowhere/x, which is not there"),
        (("make", "--out", "other"), "holds something else"),
        (("make", "--out", "other/file"), "this is a file"),
        (("solve", "other"), "no folder of blind cases"),
        (("score", "other"), "no folder of blind cases"),
        (("score", "other", "--out", "score.txt"), "its name must end in .md or .json"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_is_written(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    (tmp_path / "nothing").symlink_to("nowhere/x")
    done = marsarm(tmp_path, "gap", *words, "--json") if words[0] == "record" else blind(tmp_path, *words)
    assert done.returncode == 2
    assert said in done.stderr
    assert said in json.loads(done.stdout)["error"]
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "nothing", "other"]
