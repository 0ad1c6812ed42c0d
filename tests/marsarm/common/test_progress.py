"""Progress: the share of all work, the time left, and a line a minute where there is no terminal."""

import time

import pytest

from simgap.common import progress as module
from simgap.common.progress import ProgressState, format_duration, part_of, show_progress


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
