"""Tests of sparklines."""

import numpy as np

from simgap.common.console import SPARKLINE_WIDTH, ZERO_MARK, magnitude_sparkline, pluralize, value_sparklines


def test_one_is_one_and_all_else_is_many() -> None:
    assert [pluralize(n, "channel") for n in (0, 1, 2)] == ["0 channels", "1 channel", "2 channels"]


def test_sizes_show_where_something_is_and_how_much():
    assert magnitude_sparkline(np.array([0.0, 1e-300, 0.5, 1.0])) == "·▁▄█"
    assert magnitude_sparkline(np.array([0.0, np.inf, 2.0])) == "·██"
    assert magnitude_sparkline(np.zeros(3)) == ZERO_MARK * 3
    assert magnitude_sparkline(np.array([])) == ""


def test_a_long_line_shows_the_greatest_of_each_column():
    sizes = np.zeros(10_000)
    sizes[9_999] = 1.0
    assert magnitude_sparkline(sizes) == ZERO_MARK * (SPARKLINE_WIDTH - 1) + "█"


def test_values_are_on_one_scale_and_what_is_no_number_is_a_question():
    assert value_sparklines(np.array([0.0, 1.0]), np.array([0.5, np.nan])) == ["▁█", "▄?"]
    assert value_sparklines(np.array([2.0, 2.0]), np.array([np.inf, -np.inf])) == ["▁▁", "█▁"]
    assert value_sparklines(np.array([np.nan])) == ["?"]
