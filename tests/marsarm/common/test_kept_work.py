"""Checkpoints, progress and rates of long work."""

import json
import time
from pathlib import Path

import pytest
from scipy.stats import binom

from marsarm.common.checkpoint import Checkpoint
from marsarm.common.rates import estimate_rate
from simgap.common import progress as module
from simgap.common.errors import BadRequest
from simgap.common.progress import ProgressState, format_duration, part_of, show_progress

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


def test_the_time_left_follows_from_the_work_done() -> None:
    state = ProgressState(started_s=0.0)
    assert state.left_text(1.0) == "time left not known"
    state.update(0, 10, "arms", 10.0)
    state.update(4, 10, "arms", 50.0)
    assert state.left_s(50.0) == pytest.approx(60.0)
    assert state.left_s(70.0) == pytest.approx(40.0)
    assert state.line(50.0) == "arms: 40% after 50 s, 60 s left"


def test_work_of_which_no_share_is_done_counts_its_steps() -> None:
    state = ProgressState(started_s=0.0)
    for now_s in range(1, 8):
        state.update(0.0, 1.0, "fit", now_s)
    assert state.line(90.0) == "fit: step 7 after 90 s, time left not known"


def test_results_of_an_earlier_command_took_no_time() -> None:
    state = ProgressState(started_s=0.0)
    state.update(5, 10, "arms", 0.0)
    state.update(6, 10, "arms", 10.0)
    assert state.left_s(10.0) == pytest.approx(40.0)


def test_stages_are_parts_of_one_whole_that_never_falls() -> None:
    state = ProgressState(started_s=0.0)
    seen = []

    def update(done: float, total: float, what: str) -> None:
        state.update(done, total, what, 1.0)
        seen.append(state.share)

    first, second = part_of(update, 0.0, 0.25), part_of(update, 0.25, 1.0)
    first(1, 2, "first")
    first(2, 2, "first")
    second(0, 3, "second")
    second(1, 3, "second")
    part_of(second, 0.0, 0.5)(9, 3, "inner")
    update(0, 1, "late")
    assert seen == pytest.approx([0.125, 0.25, 0.25, 0.5, 0.625, 0.625])


@pytest.mark.parametrize(
    ("duration_s", "text"),
    [(0.2, "0 s"), (99.0, "99 s"), (100.0, "2 min"), (5400.0, "90 min"), (7260.0, "2 h 1 min")],
)
def test_a_duration_is_short_text(duration_s: float, text: str) -> None:
    assert format_duration(duration_s) == text


def test_a_line_comes_each_period_without_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LINE_PERIOD_S", 0.02)
    with show_progress() as progress:
        progress(0, 2, "arms")
        progress(1, 2, "arms")
        lines: list[str] = []
        while len(lines) < 2:  # one comes also while nothing is reported
            time.sleep(0.01)
            lines += capsys.readouterr().err.splitlines()
    assert all(line.startswith("arms: 50% after 0 s, ") and line.endswith(" left") for line in lines)
    time.sleep(0.05)
    capsys.readouterr()
    time.sleep(0.05)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("hits", "of"), [(0, 60), (3, 60), (60, 60), (17, 40)])
def test_the_interval_of_a_rate_is_that_of_the_binomial(hits, of):
    rate = estimate_rate(hits, of)
    if hits:
        assert binom.sf(hits - 1, of, rate.least) == pytest.approx(0.025)
    if hits < of:
        assert binom.cdf(hits, of, rate.most) == pytest.approx(0.025)
    assert rate.least <= hits / of <= rate.most


def test_hits_beyond_the_cases_are_refused():
    with pytest.raises(ValueError, match="5 hits of 4"):
        estimate_rate(5, 4)
