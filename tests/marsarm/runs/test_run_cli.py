"""Tests of `marsarm run` and `marsarm run --list` as a user runs them."""

import json
from pathlib import Path

import numpy as np
import pytest

from marsarm.runs.execution import choose_log, draw_picture
from marsarm.runs.request import RunFiles
from marsarm.telemetry.read import read_log
from sim.arm_model.load import default_arm
from sim.scenario.file import built_in_scenarios
from sim.setting import World
from sim.world import build
from simgap.common.errors import BadOutput
from tests.marsarm.command import SHORT_RUN, largest_file, marsarm

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
    done = marsarm(folder, "run", "short.toml", "--json", *files, *words)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
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
        done = marsarm(folder, "run", "short.toml", "--json", "--log", "run.mcap")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
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
    listed = json.loads(marsarm(tmp_path, "run", "--list", "--json").stdout)["scenarios"]
    assert [scenario["name"] for scenario in listed] == list(built_in_scenarios())
    assert all(scenario["summary"] in line for scenario, line in zip(listed, lines, strict=True))
    assert "TOOL_CHANGE" in {scenario["name"]: scenario for scenario in listed}["tool-change"]["commands"]
