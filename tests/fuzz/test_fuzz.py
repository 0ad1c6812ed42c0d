"""Tests of the log reader and the importer with a few corrupt files; the campaign fuzz tries many more."""

import time
from pathlib import Path
from typing import Any

import pytest

import validation.fuzz
from simgap.files import log_file
from validation import fuzz_inputs
from validation.fuzz import TARGETS, FuzzTarget, fuzz


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_the_seeds_are_accepted(target: FuzzTarget) -> None:
    assert all(target.run(seed) for seed in target.seeds())


def hides_all(work: Any) -> FuzzTarget:
    """Make a target that treats every exception as a corrupt file, as decoders do."""

    def run(_: bytes) -> bool:
        try:
            work()
        except Exception:
            return False
        return True

    return FuzzTarget("hides", run, lambda: [b"seed"])


def test_a_hang_is_seen_though_the_target_catches_every_exception(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(validation.fuzz, "SLOWEST_S", 0.05)
    found = fuzz(hides_all(lambda: time.sleep(60)), 6, seconds=300.0, most=1)
    assert "TooSlow" in found["why"]
    assert Path(found["failed"]).exists()


def test_memory_that_grows_is_seen_though_the_target_gives_it_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    had = iter([0, 2 << 30])
    monkeypatch.setattr(validation.fuzz, "peak_bytes", lambda: next(had))
    found = fuzz(hides_all(lambda: None), 6, seconds=300.0, most=1)
    assert "MemoryError: the process grew by 2147483648 bytes" in found["why"]


def test_a_table_that_asks_for_all_of_the_memory_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def bomb(*_: Any) -> None:
        raise MemoryError

    monkeypatch.setattr(log_file, "open_csv", bomb)
    with pytest.raises(MemoryError):
        fuzz_inputs.import_once(fuzz_inputs.import_seeds()[0])
