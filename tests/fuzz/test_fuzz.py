"""A few broken files for each thing that reads files of others; `make fuzz` tries many more."""

from pathlib import Path

import pytest

from benchmarks.fuzz import TARGETS, Target, fuzz

TRIES = 400


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_broken_files_are_refused_with_an_error_that_says_so(
    target: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = fuzz(target, 6, seconds=300.0, most=TRIES)
    assert found["failed"] is None, found["why"]
    assert found["tries"] == TRIES
    assert 0 < found["accepted"] < TRIES


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_the_seeds_are_accepted(target: Target) -> None:
    assert all(target.run(seed) for seed in target.seeds())
