"""Reference runs replay, and those that no longer do are made anew."""

import json
import warnings
from io import StringIO

import pytest
from rich.console import Console

from marsarm.replaying.replay import OTHER_PROCESSOR_TOLERANCE, ReplayRequest, replay, verdict_line
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import cpu_features
from tests.replay.remake import FOLDER, make, path_of, tell
from tests.replay.runs import RUNS

MOST_BYTES = 1_500_000


def silent(*_) -> None:
    """Ignore progress."""


@pytest.mark.filterwarnings("always:.*is compared to")
@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.name)
def test_a_reference_run_replays_without_a_difference(run):
    report = replay(ReplayRequest(path_of(run)), silent)
    if not report.same_processor:
        made_by = json.loads(report.header["cpu"])
        odd = sorted({*made_by} ^ {*cpu_features()})
        warnings.warn(
            f"{run.name} is compared to {OTHER_PROCESSOR_TOLERANCE:g}: made without or with {odd}",
            stacklevel=1,
        )
    assert report.differences.identical, verdict_line(report.differences)
    assert report.notes == ()


@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.name)
def test_a_reference_run_came_to_what_it_is_there_for(run):
    log = read_log(path_of(run))
    assert run.ends_with in [evr.name for evr in log.evrs]
    assert not log.truncated


def test_the_reference_runs_are_few_and_small_and_all_known():
    files = sorted(FOLDER.glob("*.mcap"))
    assert files == sorted(path_of(run) for run in RUNS)
    assert len(files) <= 10
    assert sum(file.stat().st_size for file in files) < MOST_BYTES


def test_a_log_made_elsewhere_is_said_to_be_compared_within_a_tolerance(tmp_path, monkeypatch):
    monkeypatch.setattr("marsarm.replaying.replay.cpu_features", lambda: ("another",))
    report = replay(ReplayRequest(FOLDER / "fault.mcap"), silent)
    assert not report.same_processor
    assert report.differences.tolerance == OTHER_PROCESSOR_TOLERANCE
    assert verdict_line(report.differences).startswith("the same to 1e-12")


(SHORT,) = (run for run in RUNS if run.name == "no-number")


def print_differences(old, new) -> tuple[bool, str]:
    console = Console(file=StringIO(), width=200)
    return tell(SHORT, old, new, console), console.file.getvalue()


def test_a_run_that_is_made_again_is_the_same(tmp_path):
    again = tmp_path / "again"
    again.mkdir()
    differs, printed = print_differences(make(SHORT, tmp_path), make(SHORT, again))
    assert not differs
    assert printed == "no-number: identical: 88 ticks, 1.4 s, 39 channels\n"


def test_what_differs_is_printed():
    differs, printed = print_differences(FOLDER / "fault.mcap", path_of(SHORT))
    assert differs
    assert "recorded is what the file held, replayed the run made anew" in printed
    assert "missing  ResolverDisagrees" in printed
    assert "header    has another commands" in printed
