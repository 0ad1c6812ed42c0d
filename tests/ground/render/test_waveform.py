"""Numbers as lines of blocks."""

import numpy as np

from ground.render.waveform import NOTHING, WIDTH, size_line, value_lines


def test_sizes_show_where_something_is_and_how_much():
    assert size_line(np.array([0.0, 1e-300, 0.5, 1.0])) == "·▁▄█"
    assert size_line(np.array([0.0, np.inf, 2.0])) == "·██"
    assert size_line(np.zeros(3)) == NOTHING * 3
    assert size_line(np.array([])) == ""


def test_a_long_line_shows_the_greatest_of_each_column():
    sizes = np.zeros(10_000)
    sizes[9_999] = 1.0
    assert size_line(sizes) == NOTHING * (WIDTH - 1) + "█"


def test_values_are_on_one_scale_and_what_is_no_number_is_a_question():
    assert value_lines(np.array([0.0, 1.0]), np.array([0.5, np.nan])) == ["▁█", "▄?"]
    assert value_lines(np.array([2.0, 2.0]), np.array([np.inf, -np.inf])) == ["▁▁", "█▁"]
    assert value_lines(np.array([np.nan])) == ["?"]
