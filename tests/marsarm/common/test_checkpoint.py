"""Tests of result files: an interrupted run continues from them."""

import json
from pathlib import Path

import pytest

from marsarm.accuracy.monte_carlo import Checkpoint
from simgap.common.errors import BadRequest

ASKED = {"case": "mars", "seed": 1}


def written(path: Path, *results: dict) -> None:
    with Checkpoint(path, ASKED) as file:
        for result in results:
            file.add(result)


def test_what_was_written_is_there_again(tmp_path):
    path = tmp_path / "r.jsonl"
    written(path, {"arm": 0}, {"arm": 1})
    written(path, {"arm": 2})
    with Checkpoint(path, ASKED) as file:
        assert file.done == [{"arm": 0}, {"arm": 1}, {"arm": 2}]


@pytest.mark.parametrize("cut", range(1, 40))
def test_a_torn_line_is_forgotten_wherever_it_was_cut(tmp_path, cut):
    path = tmp_path / "r.jsonl"
    written(path, {"arm": 0}, {"arm": 1})
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    written(path, {"arm": 7})
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert lines[0] == {"request": ASKED}
    assert lines[-1] == {"arm": 7}
    kept = {"arm": 0} in lines, {"arm": 1} in lines
    assert kept == (cut <= len(b'{"arm": 1}\n'), False)


def test_results_of_another_request_are_refused_and_kept(tmp_path):
    path = tmp_path / "r.jsonl"
    written(path, {"arm": 0})
    before = path.read_bytes()
    with pytest.raises(BadRequest, match=r"of another request \(seed 1 there, 2 now\)"):
        Checkpoint(path, {**ASKED, "seed": 2})
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arm,error\n0,1\n", "holds something else"),
        ('{"request": 1\n', "line 1 is not JSON"),
        ("hello", "holds something else"),
        ('{"arm": 0}\n', "holds something else"),
        ('{"request": {"case": "mars", "seed": 1}}\n[1]\n', "line 2 is no result"),
        ('{"request": {"case": "mars", "seed": 1}}\n{"ar\n{"arm": 1}\n', "line 2 is not JSON"),
    ],
)
def test_a_file_of_something_else_is_refused_and_kept(tmp_path, text, words):
    path = tmp_path / "r.jsonl"
    path.write_text(text)
    with pytest.raises(BadRequest, match=words):
        Checkpoint(path, ASKED)
    assert path.read_text() == text


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BadRequest, match="cannot be written"):
        Checkpoint(tmp_path / "no" / "r.jsonl", ASKED)
