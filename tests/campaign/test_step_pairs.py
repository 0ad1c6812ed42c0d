"""Tests of the comparison of two trees by the time of a cycle."""

import os
from pathlib import Path

import pytest

from simgap.common.errors import BadRequest
from validation.campaigns import ROOT, Context
from validation.step_pairs import TimedTree, campaign, compare


def test_the_ratio_is_the_median_of_pairs_and_blocks():
    slow_block = ([10.0, 20.0, 99.0], [10.0, 20.0, 33.0])
    slower = ([11.0, 22.0, 33.0], [10.0, 20.0, 30.0])
    fast = ([9.0, 9.0, 9.0], [10.0, 10.0, 10.0])
    found = compare([slow_block, slower, fast])
    assert (found["ratio"], found["least"], found["largest"]) == (1.0, 0.9, 1.1)


def test_a_process_times_flight_software_of_its_own_tree():
    timed = TimedTree(ROOT, "rest", min(os.sched_getaffinity(0)))
    assert timed.next_ns() > 0
    timed.end()


def test_a_folder_without_flight_software_is_no_checkout(tmp_path: Path):
    with pytest.raises(BadRequest, match="is not a checkout"):
        campaign(Context(), other=tmp_path)


def test_a_checkout_that_cannot_be_timed_is_refused(tmp_path: Path):
    (tmp_path / "fsw").mkdir()
    (tmp_path / "fsw" / "__init__.py").write_text("raise SystemExit(1)\n")
    with pytest.raises(BadRequest, match="has no flight software that can be timed"):
        TimedTree(tmp_path, "rest", min(os.sched_getaffinity(0)))
