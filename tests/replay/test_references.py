"""Reference runs replay, and those that no longer do are made anew."""

import json
import warnings
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from marsarm.replaying.compare import compare_behaviours
from marsarm.replaying.inputs import behaviour_from_outputs, inputs_from_log
from marsarm.replaying.replay import (
    OTHER_PROCESSOR_TOLERANCE,
    ReplayRequest,
    replay,
    run_flight_software,
    verdict_line,
)
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


def test_one_bit_of_a_gain_is_seen_in_its_channel_from_the_tick_on_which_it_matters():
    inputs = inputs_from_log(read_log(FOLDER / "contact.mcap"))
    before = run_flight_software(inputs, inputs.params, silent)
    elevation = inputs.params.joints.elevation
    gain = np.nextafter(elevation.gear_stiffness_Nm_rad, np.inf).item()
    joints = replace(inputs.params.joints, elevation=replace(elevation, gear_stiffness_Nm_rad=gain))
    after = run_flight_software(inputs, replace(inputs.params, joints=joints), silent)
    found = compare_behaviours(behaviour_from_outputs(before), behaviour_from_outputs(after))
    changed = {one.channel: one for one in found.channels}
    assert [evr.event.name for evr in found.evrs] == ["Booted"]
    assert found.lengths == ()
    seen = changed["/joint.backlash_uncertainty_rad"]
    assert seen.first_component == (1,)
    assert 0 < seen.greatest < 1e-15
    apart = [
        tick
        for tick, (was, now) in enumerate(zip(before, after, strict=True))
        if was.joint.backlash_uncertainty_rad[1] != now.joint.backlash_uncertainty_rad[1]
    ]
    assert (seen.first_tick, seen.ticks) == (apart[0], len(apart))


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
    assert printed == "no-number: identical: 81 ticks, 1.3 s, 26 channels\n"


def test_what_differs_is_printed():
    differs, printed = print_differences(FOLDER / "fault.mcap", path_of(SHORT))
    assert differs
    assert "recorded is what the file held, replayed the run made anew" in printed
    assert "missing  ResolverDisagrees" in printed
    assert "header    has another commands" in printed
