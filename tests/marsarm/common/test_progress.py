"""Progress: the share of all work, the time left, and lines where there is no terminal."""

import time

import numpy as np
import pytest

from fsw.kinematics.transforms import Array
from simgap.common import progress


def test_the_time_left_follows_from_the_work_done():
    state = progress.ProgressState(started_s=0.0)
    assert state.left_text(1.0) == "time left not known"
    state.update(0, 10, "arms", 10.0)
    state.update(4, 10, "arms", 50.0)
    assert state.left_s(50.0) == pytest.approx((60.0, 60.0))
    assert state.line(50.0) == "arms: 40% after 50 s, 60 s left"


def test_while_a_step_lasts_the_time_left_is_a_range_that_holds_the_truth():
    """The step ends now, or it has only begun."""
    state = progress.ProgressState(started_s=0.0)
    state.update(0, 10, "arms", 10.0)
    state.update(4, 10, "arms", 50.0)
    assert state.left_s(70.0) == pytest.approx((40.0, 90.0))
    assert state.line(70.0) == "arms: 40% after 70 s, 40 s to 90 s left"
    assert state.line(200.0).endswith("0 s to 5 min left")


def test_work_of_which_no_share_is_done_counts_its_steps():
    state = progress.ProgressState(started_s=0.0)
    for now_s in range(1, 8):
        state.update(0.0, 1.0, "fit", now_s)
    assert state.line(90.0) == "fit: step 7 after 90 s, time left not known"


def test_stages_are_parts_of_one_whole_that_never_falls():
    state = progress.ProgressState(started_s=0.0)
    seen = []

    def update(done: float, total: float, what: str) -> None:
        state.update(done, total, what, 1.0)
        seen.append(state.share)

    first, second = progress.part_of(update, 0.0, 0.25), progress.part_of(update, 0.25, 1.0)
    first(1, 2, "first")
    first(2, 2, "first")
    second(0, 3, "second")
    second(1, 3, "second")
    progress.part_of(second, 0.0, 0.5)(9, 3, "inner")
    update(0, 1, "late")
    assert seen == pytest.approx([0.125, 0.25, 0.25, 0.5, 0.625, 0.625])


@pytest.mark.parametrize(
    ("duration_s", "text"),
    [(0.2, "0 s"), (99.0, "99 s"), (100.0, "2 min"), (5400.0, "90 min"), (7260.0, "2 h 1 min")],
)
def test_a_duration_is_short_text(duration_s, text):
    assert progress.format_duration(duration_s) == text


def test_lines_come_without_a_terminal(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(progress, "WAITS_S", (0.02, 0.01))
    with progress.show_progress("job", "") as report:
        report(0, 2, "arms")
        report(1, 2, "arms")
        lines: list[str] = []
        while len(lines) < 3:  # one comes also while nothing is reported
            time.sleep(0.01)
            lines += capsys.readouterr().err.splitlines()
    assert all(line.startswith("arms: 50% after 0 s, ") and line.endswith(" left") for line in lines)
    time.sleep(0.05)
    capsys.readouterr()
    time.sleep(0.05)
    assert capsys.readouterr().err == ""
    assert not list(tmp_path.iterdir())  # so short a run needs no time left


STAGES = ((0.1, 2.0), (0.5, 90.0), (0.6, 92.0), (1.0, 100.0))
"""Shares that are far from the shares of the time, and seconds."""


@pytest.mark.parametrize("size", [0.1, 0.5, 1.0, 3.0, 10.0])
def test_the_time_left_of_a_run_of_another_size_is_right_within_a_factor_of_two(size):
    state = progress.ProgressState(0.0, progress.EarlierRun.of_points(STAGES, 100.0))
    fine = [(share / 100, time_s) for share, time_s in zip(range(101), _times_s(size), strict=True)]
    for share, time_s in fine:
        state.update(share, 1.0, "work", time_s)
        left_s = state.left_s(time_s)
        if 10.0 <= time_s < 100.0 * size:
            assert left_s is not None
            assert 0.5 <= left_s[0] / (100.0 * size - time_s) <= 2.0


def _times_s(size: float) -> Array:
    """Return the time at each percent of a run with the stages of STAGES."""
    shares, times_s = zip((0.0, 0.0), *STAGES, strict=True)
    return size * np.interp(np.linspace(0.0, 1.0, 101), shares, times_s)


def tell_left_s(stage: tuple[float, float], total: float) -> tuple[float, float] | None:
    """Return the time left after a quarter of a stage, which is reported with this total."""
    state, times_s = progress.ProgressState(0.0), iter((5.0, 10.0))
    part = progress.part_of(lambda *report: state.update(*report, next(times_s)), *stage)
    part(0.0, total, "fit")
    part(0.25 * abs(total), total, "fit")
    return state.left_s(12.0)


@pytest.mark.parametrize("stage", [(0.0, 1.0), (0.2, 0.6)])
def test_a_guessed_share_tells_a_range_from_half_to_twice_what_a_counted_one_tells(stage):
    counted, guessed = tell_left_s(stage, 1.0), tell_left_s(stage, progress.GUESS)
    assert counted is not None
    assert guessed == pytest.approx((counted[0] / 2.0, counted[1] * 2.0))


def test_the_first_hundredth_of_a_guess_tells_no_time_left():
    state = progress.ProgressState(0.0)
    for share, is_told in ((0.0, False), (0.009, False), (0.02, True)):
        state.update(share, progress.GUESS, "work", 1.0 + share)
        assert (state.left_s(2.0) is not None) == is_told


def test_a_step_that_lasts_longer_than_all_that_a_guess_has_left_tells_no_time_left():
    state = progress.ProgressState(0.0)
    for share, now_s in ((0.0, 1.0), (0.9, 10.0)):
        state.update(share, progress.GUESS, "refit", now_s)
    assert state.left_s(10.5) == pytest.approx((0.25, 2 * 9.5 / 9.0))
    assert state.left_s(11.5) is None
    state.update(1.0, progress.GUESS, "done", 12.0)
    assert state.left_s(20.0) == (0.0, 0.0)


def test_beside_an_earlier_run_a_guessed_share_tells_what_a_counted_one_tells():
    told = []
    for total in (1.0, progress.GUESS):
        state = progress.ProgressState(0.0, progress.EarlierRun((0.0, 0.6, 1.0), (0.0, 60.0, 100.0)))
        state.update(0.25, total, "fit", 10.0)
        told.append(state.left_s(12.0))
    assert told[0] == told[1]


def test_what_nobody_knows_stays_unknown_in_a_guess_and_in_a_stage():
    state = progress.ProgressState(0.0)
    for wrap in (progress.as_guess, lambda update: progress.part_of(update, 0.2, 0.6)):
        wrap(lambda *report: state.update(*report, 1.0))(0.0, 0.0, "reading")
    assert (state.what, state.first_share) == ("reading", None)


def test_a_last_step_that_takes_longer_than_in_the_earlier_run_tells_no_time():
    state = progress.ProgressState(0.0, progress.EarlierRun.of_points([(0.5, 10.0)], 20.0))
    state.update(0.5, 1.0, "fit", 10.0)
    assert state.left_s(15.0) == pytest.approx((5.0, 5.0))
    assert state.left_s(25.0) is None


def test_the_course_of_a_run_is_kept_for_the_next_one(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert progress.read_earlier_run("job", "a.csv") is None
    run = progress.EarlierRun.of_points([(0.0, 1.0), (0.3, 40.0), (0.305, 41.0), (1.0, 60.0)], 61.0)
    assert run.shares == (0.0, 0.3, 1.0)
    progress.keep_run("job", "a.csv", run)
    assert progress.read_earlier_run("job", "a.csv") == run
    progress.keep_run("job", "a.csv", progress.EarlierRun.of_points([], 1.0))
    assert progress.read_earlier_run("job", "a.csv") == run
    assert progress.read_earlier_run("job", "b.csv") is None
    monkeypatch.chdir(tmp_path)  # where a.csv is another file
    assert progress.read_earlier_run("job", "a.csv") is None
    (tmp_path / "simgap/progress/job.json").write_text("[[0, 1")
    assert progress.read_earlier_run("job", "a.csv") is None
