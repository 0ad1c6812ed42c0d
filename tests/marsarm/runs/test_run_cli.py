"""`marsarm run`, `place` and `hardstop` as a user runs them, and memory of a run without a log."""

import gc
import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from fsw.dictionary.commands import MoveJoint, Process
from fsw.dictionary.enums import Joint
from fsw.dictionary.faults import StalledEarly
from helpers.command import run_python
from marsarm.runs.execution import FRAME_CYCLES, choose_log, draw_picture, execute
from marsarm.runs.place import place
from marsarm.runs.report import place_document, place_parts
from marsarm.runs.request import NO_FILES, PlaceRequest, RunFiles
from marsarm.telemetry.read import read_log
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params
from sim.effects.joints import HardstopAngle
from sim.loop import ClosedLoop
from sim.scenario.data import Done, GravityHeld, Scenario
from sim.scenario.file import built_in_scenarios
from sim.scenario.run import ScenarioRun, scenario_setup
from sim.sequence import Outcome
from sim.setting import World
from sim.world import build
from simgap.common.errors import BadOutput
from simgap.common.progress import no_progress
from simgap.common.report import print_parts
from tests.marsarm.command import ROOT, SHORT_RUN, largest_file, marsarm, marsarm_json
from tests.sim import lab

REFUSED = SHORT_RUN + '\n[[command]]\ntype = "CALIBRATE"\njoint = "elbow"\n'
MISSED = SHORT_RUN + '\n[[check]]\ntype = "stowed"\n'
CUT = SHORT_RUN + '\n[[fault]]\ntype = "POWER_LOSS"\nduring = 1\nafter_s = 1\n'


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr("marsarm.runs.execution.PICTURE_SIZE", (320, 200))


@pytest.fixture
def folder(tmp_path):
    for name, text in (("short", SHORT_RUN), ("refused", REFUSED), ("missed", MISSED), ("cut", CUT)):
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


@pytest.mark.usefixtures("is_initialised")
def test_a_run_that_passes_says_what_was_measured_and_keeps_what_was_asked_for(folder):
    words = ("--arm", "calibrated:1", "--tilt", "3", "-4", "--log", "run.mcap")
    files = ("--picture", "run.png", "--page", "run.html")
    report = marsarm_json(folder, "run", "short.toml", *files, *words)
    assert (report["scenario"], report["outcome"], report["passed"]) == ("short", "done", True)
    assert report["arm"] == "calibrated:1"
    assert report["tilt_deg"] == {"roll": pytest.approx(3), "pitch": pytest.approx(-4)}
    (check,) = report["checks"]
    numbers = {"value": 1.0, "unit": None, "low": 1.0, "high": 1.0}
    assert check == {"check": "done", "name": "every command carried out", "passed": True} | numbers
    log = read_log(folder / "run.mcap")
    assert len(log["/joint"]) == len(log["/truth"]) == round(report["duration_s"] * 64)
    assert [entry.name for entry in log.evrs] == [evr["name"] for evr in report["evrs"]]
    for name in ("run.png", "run.html"):
        assert (folder / name).stat().st_size > 5_000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "outcome", "said"),
    [
        ("refused", "refused", "ended in command 2, CALIBRATE"),
        ("cut", "faulted", "response BRAKE_AND_REFUSE"),
        ("missed", "done", "NOT passed"),
    ],
)
def test_a_run_that_is_refused_faults_or_misses_a_check_ends_with_status_3(folder, name, outcome, said):
    done = marsarm(folder, "run", f"{name}.toml")
    assert done.returncode == 3, done.stderr
    words = " ".join(done.stdout.split())
    assert f"arm nominal: {outcome}, NOT passed" in words
    assert said in words
    assert [path.name for path in folder.iterdir() if path.suffix != ".toml"] == []


def test_a_picture_is_written_whole_or_not_at_all(tmp_path):
    path, model = tmp_path / "scene.png", default_arm()
    with largest_file(1000):
        problem = draw_picture(path, World(), model, np.zeros(build(World(), model).compile().nq))
    assert problem == f"no picture: {path} cannot be written (File too large)"
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_full_disk_does_not_end_the_run_and_an_event_tells(folder):
    with largest_file(100_000):
        report = marsarm_json(folder, "run", "short.toml", "--log", "run.mcap")
    assert (report["outcome"], report["passed"]) == ("done", True)
    said = report["evrs"][-1]
    assert (said["name"], said["severity"]) == ("LogNotWritten", "WARNING_HI")
    assert "File too large" in said["message"]
    log = read_log(folder / "run.mcap")
    assert log.truncated
    assert len(log["/joint"]) == round(64 * said["fields"]["from_s"])


def test_only_a_page_without_a_log_needs_a_temporary_folder(monkeypatch):
    def no_folder():
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("marsarm.runs.execution.TemporaryDirectory", no_folder)
    page, log = Path("run.html"), Path("run.mcap")
    for files in (RunFiles(), RunFiles(log=log), RunFiles(page=page, log=log)):
        with choose_log(files) as path:
            assert path == files.log
    with pytest.raises(BadOutput, match=r"page run.html: .*No space left on device\); set TMPDIR"):
        choose_log(RunFiles(page=page)).__enter__()


def test_the_scenarios_are_listed_with_a_line_each(tmp_path):
    done = marsarm(tmp_path, "run", "--list")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(built_in_scenarios())
    listed = marsarm_json(tmp_path, "run", "--list")["scenarios"]
    assert [scenario["name"] for scenario in listed] == list(built_in_scenarios())
    assert all(scenario["summary"] in line for scenario, line in zip(listed, lines, strict=True))
    assert "TOOL_CHANGE" in {scenario["name"]: scenario for scenario in listed}["tool-change"]["commands"]


GRAVITY_T = (-0.02, 0.0, -1.0)
"""Gravity in the axes of the portioner in the ready pose, almost."""
FIRST, LAST = FRAME_CYCLES, 4 * FRAME_CYCLES
"""Cycles in the first command and in the second."""


@pytest.mark.slow
def test_a_run_that_shakes_and_moves_keeps_no_object_of_each_cycle():
    """No line keeps as many more blocks as there are cycles; caches of NumPy keep a few, never the same."""
    commands = (Process("portion", GRAVITY_T, 6.0), MoveJoint(Joint.TURRET, 1.4))
    checks = (Done(), GravityHeld(1, "portion", GRAVITY_T))
    scenario = Scenario("test", "T", "S.", World(), commands, checks, "ready")
    arm = arm_named("nominal")
    loop = ClosedLoop(scenario_setup(scenario, arm, lab.true_reference(arm), 1))
    run, kept = ScenarioRun(loop, scenario), {}

    def note(record):
        if record.tick in (FIRST, LAST):
            gc.collect()
            kept[record.tick] = tracemalloc.take_snapshot()
        return run.guess_share(record.tick), 1.0

    tracemalloc.start()
    try:
        done = execute(
            run, loop, {}, NO_FILES, scenario.world, no_progress, note, lambda _: False, arm.model, "T"
        )
    finally:
        tracemalloc.stop()
    assert done.result.passed
    lines = kept[LAST].compare_to(kept[FIRST], "lineno")
    assert max(lines, key=lambda line: line.count_diff).count_diff < LAST - FIRST


@pytest.mark.slow
def test_one_joint_is_found_and_drawn_and_people_see_a_table_and_what_was_said(tmp_path):
    words = ("--arm", "as-built:5", "--temperature", "-55", "--picture", "turret.png")
    done = marsarm(tmp_path, "hardstop", "--joint", "turret", *words)
    assert done.returncode == 0, done.stderr
    assert "TURRET calibrated" in done.stdout
    assert "zero error" in done.stdout
    with PIL.Image.open(tmp_path / "turret.png") as image:
        assert image.width > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["turret.png"]


@pytest.mark.slow
def test_every_as_built_joint_finds_its_zero_in_the_cold_one_after_the_other(tmp_path):
    document = marsarm_json(tmp_path, "hardstop", "--arm", "as-built:3", "--temperature", "-55")
    assert set(document["joints"]) == {joint.name.lower() for joint in Joint}
    for joint, params in zip(Joint, nominal_params().joints.in_order(), strict=True):
        found = document["joints"][joint.name.lower()]
        assert abs(found["zero_error_mrad"]) < 0.3
        assert abs(found["uncorrected_error_mrad"]) > 1.0  # wind-up is corrected
        assert found["max_torque_Nm"] < params.hardstop_rated_Nm
    assert document["max_current_ratio"] <= 1.0 + 1e-9
    assert "CommandCompleted" in [evr["name"] for evr in document["evrs"]]


def test_a_load_that_hides_the_hardstop_is_refused(tmp_path):
    document = marsarm_json(tmp_path, "hardstop", "--joint", "elevation", "--scene", "earth", status=3)
    assert (document["outcome"], document["max_current_ratio"]) == ("refused", 0.0)
    assert "gravity presses it on its hardstop" in document["evrs"][-1]["message"]


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
    report = marsarm_json(tmp_path, "place", "--no-surface", "--log", "run.mcap", status=3)
    assert report["outcome"] == "faulted"
    assert report["error_mm"] is None
    assert "NoContact" in [evr["name"] for evr in report["evrs"]]
    assert "Retract accepted" not in [evr["message"] for evr in report["evrs"]]
    log = read_log(tmp_path / "run.mcap")
    assert not log["/drive"]["brake_release"][-1].any()
    assert not log["/drive"]["power_on"][-1].any()


@pytest.mark.slow
@pytest.mark.parametrize("value", ["nonsense", " OFF "])
def test_no_setting_of_opengl_stops_the_import(tmp_path, value):
    words = ("-c", "from marsarm.__main__ import start; start()", "place", "--tool", "spoon")
    done = run_python(tmp_path, *words, PYTHONPATH=str(ROOT), MUJOCO_GL=value)
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
