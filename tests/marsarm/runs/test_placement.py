"""Placements by the command."""

import json
from dataclasses import replace

import pytest

from fsw.dictionary.enums import Joint
from fsw.dictionary.faults import StalledEarly
from helpers.marks import slow_but
from marsarm.runs.place import place
from marsarm.runs.report import place_document, place_parts
from marsarm.runs.request import PlaceRequest, RunFiles
from marsarm.telemetry.read import read_log
from sim.arms import arm_named
from sim.effects.joints import HardstopAngle
from sim.sequence import Outcome
from simgap.common.report import print_parts
from tests.marsarm.command import marsarm, marsarm_process


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Run `marsarm show` over files of another run; return the folder, what ended, and the report."""
    folder, reports = tmp_path_factory.mktemp("shown"), []
    for name in ("here.png", "run.mcap"):
        (folder / name).write_bytes(b"of another run")

    def place_and_keep(*given):
        reports.append(place(*given))
        return reports[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("marsarm.runs.place.place", place_and_keep)
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            patch.delenv(name, raising=False)
        done = marsarm(folder, "show", "--json", "--picture", "here.png", "--log", "run.mcap")
    return folder, done, reports[0]


@pytest.mark.slow
def test_the_defaults_show_a_good_placement_by_the_path_of_its_page_where_there_is_no_display(shown):
    folder, done, _ = shown
    assert done.returncode == 0, done.stderr
    assert "place.html: there is no display here; open it in any browser\n" in done.stderr
    report = json.loads(done.stdout)
    assert (report["outcome"], report["page"], report["picture"]) == ("done", "place.html", "here.png")
    assert report["error_mm"]["total"] < 1.0
    assert report["error_mm"].keys() >= {"total", "lateral", "normal"}
    assert report["axis_error_deg"] < 0.2
    assert report.keys() >= {"branch", "duration_s", "realtime_factor", "evrs", "log"}
    assert {path.name for path in folder.iterdir()} == {"place.html", "here.png", "run.mcap"}
    assert (folder / "here.png").stat().st_size > 10_000


@pytest.mark.slow
def test_people_see_a_table_with_units_and_which_files_were_replaced(shown, capsys):
    print_parts(place_parts(shown[-1]))
    printed = capsys.readouterr().out
    replaced = ("here.png, in place of an older one", "run.mcap, in place of an older one")
    for word in ("total mm", "axis deg", "in contact", "branch", *replaced):
        assert word in printed


@pytest.mark.slow
def test_the_log_holds_every_cycle_and_the_truth_apart(shown):
    folder, done, _ = shown
    log = read_log(folder / "run.mcap")
    cycles = round(json.loads(done.stdout)["duration_s"] * 64)
    assert not log.truncated
    assert len(log["/sensors"]) == len(log["/drive"]) == len(log["/joint"]) == len(log["/truth"]) == cycles
    assert [entry.name for entry in log.evrs] == [evr["name"] for evr in json.loads(done.stdout)["evrs"]]


@pytest.mark.slow
@pytest.mark.usefixtures("is_initialised")
def test_a_target_without_a_surface_ends_as_a_fault_with_the_brakes_on(tmp_path):
    done = marsarm(tmp_path, "place", "--no-surface", "--json", "--log", "run.mcap")
    assert done.returncode == 3, done.stderr
    report = json.loads(done.stdout)
    assert report["outcome"] == "faulted"
    assert report["error_mm"] is None
    assert "NoContact" in [evr["name"] for evr in report["evrs"]]
    assert "Retract accepted" not in [evr["message"] for evr in report["evrs"]]
    log = read_log(tmp_path / "run.mcap")
    assert not log["/drive"]["brake_release"][-1].any()
    assert not log["/drive"]["power_on"][-1].any()


@pytest.mark.parametrize("value", slow_but(["nonsense", " OFF "], "nonsense"))
def test_no_setting_of_opengl_stops_the_import(tmp_path, value):
    done = marsarm_process(tmp_path, "place", "--tool", "spoon", MUJOCO_GL=value)
    assert done.returncode == 2
    assert "tool: 'spoon' cannot be placed" in done.stderr


def test_an_arm_that_finds_no_hardstop_is_not_placed_and_its_log_is_said_not_to_be(tmp_path, monkeypatch):
    arm = arm_named("nominal")
    in_the_way = tuple(HardstopAngle(joint, 0.03) for joint in Joint)
    monkeypatch.setattr("marsarm.common.requests.arm_named", lambda *_: replace(arm, effects=in_the_way))
    report = place(PlaceRequest(files=RunFiles(log=tmp_path / "run.mcap")))
    result = report.execution.result
    assert result.outcome is Outcome.FAULTED
    assert any(isinstance(evr, StalledEarly) for _, evr in result.evrs)
    assert result.contact is place_document(report)["error_mm"] is None
    assert "not recorded (the arm was not initialised)" in report.execution.artifacts.log_problem
    assert not list(tmp_path.iterdir())
