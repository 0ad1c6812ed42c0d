"""Tests of logs of any robot with a few flipped bits; the campaign robot-logs flips many more."""

from pathlib import Path

import pytest

from validation.robot_logs import FORMATS, LogFormat, flip_bits


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_flipped_bit_changes_no_number_without_a_word(form: LogFormat, tmp_path: Path) -> None:
    found = flip_bits(form, 15, 6, tmp_path)
    assert found["wrong"] == []
    assert found["refused"] > 0
