"""Tests of the comparison of two trees by the time of a cycle."""

import os
from pathlib import Path

import pytest

from simgap.common.errors import BadRequest
from validation.campaigns import ROOT, Context
from validation.step_pairs import PARTS, TimedTree, campaign, compare


def test_the_ratio_is_the_median_of_pairs_between_two_of_them():
    assert compare([1.1, 0.9, 1.0]) == {"ratio": 1.0, "from": 0.9, "to": 1.1}
    assert compare([float(k) for k in range(16)]) == {"ratio": 7.5, "from": 3.0, "to": 12.0}


def test_a_process_times_flight_software_of_its_own_tree():
    timed = TimedTree(ROOT, min(os.sched_getaffinity(0)))
    assert all(timed.next_ns(part) > 0 for part in PARTS)
    timed.end()


def test_a_folder_without_flight_software_is_no_checkout(tmp_path: Path):
    with pytest.raises(BadRequest, match="is not a checkout"):
        campaign(Context(), other=tmp_path)


def test_a_checkout_that_cannot_be_timed_is_refused(tmp_path: Path):
    (tmp_path / "fsw").mkdir()
    (tmp_path / "fsw" / "__init__.py").write_text("raise SystemExit(1)\n")
    with pytest.raises(BadRequest, match="has no flight software that can be timed"):
        TimedTree(tmp_path, min(os.sched_getaffinity(0)))
