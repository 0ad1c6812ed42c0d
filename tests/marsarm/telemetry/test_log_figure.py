"""Text in the figure of a log."""

import matplotlib.figure
import pytest

from marsarm.telemetry import inspection as log_figure
from marsarm.telemetry.inspection import select_channels
from marsarm.telemetry.read import read_log
from validation.speed import record_log

matplotlib.use("agg")


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Return a function that draws channels, and returns the log and the panels."""
    log = read_log(record_log(tmp_path / "run.mcap", 130, 0.0))

    def draw(*globs):
        figures = []

        def keep(path, size, dpi, draw_on):
            figure = matplotlib.figure.Figure(figsize=size)
            draw_on(figure)
            figures.append(figure)

        monkeypatch.setattr(log_figure, "save_figure", keep)
        log_figure.save_log_figure(select_channels(log, globs), log.evrs, tmp_path / "p.png")
        return log, figures[0].axes

    return draw


def test_modes_are_called_by_name(drawn):
    _, (axes,) = drawn("/joint.mode")
    assert "DEPLOYED" in [label.get_text() for label in axes.get_yticklabels()]


def test_too_many_lines_to_name_are_reported(drawn):
    _, (axes,) = drawn("/truth.R_RT")
    assert "lines are too many to name; /truth.R_RT[0,0" in axes.get_title(loc="left")
    _, (axes,) = drawn("/joint.motor_rad")
    assert axes.get_title(loc="left") == "/joint.motor_rad"
    assert len(axes.get_legend().get_texts()) == 5


def test_every_event_is_named_or_counted(drawn):
    log, (axes,) = drawn("/joint.mode")
    named = len(axes.texts)
    assert axes.get_title(loc="right") == f"{len(log.evrs) - named} more events, not named"
