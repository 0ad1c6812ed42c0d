"""`marsarm place` as a user meets it: what it prints, what it refuses, and what it leaves on the disk."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ground.telemetry.read import read_log

PARAMS_BEYOND = "[joints.elbow]\nspeed_rad_s = 5.0\n"
PARAMS_UNKNOWN = "[joints.elbow]\nspede_rad_s = 0.01\n"


def marsarm(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from ground.cli import main; main()", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)


BAD = {
    "unreachable": (("--target", "9", "9", "9"), "out of reach"),
    "beyond every limit": (
        ("--target", "1.3", "-1", "-0.1", "--normal", "0", "1", "0"),
        "joint elevation: -199",
    ),
    "normal without length": (("--normal", "0", "0", "0"), "no direction"),
    "NaN target": (("--target", "nan", "0", "0"), "finite"),
    "infinite normal": (("--normal", "0", "inf", "0"), "finite"),
    "NaN tilt": (("--tilt-roll", "nan"), "finite"),
    "text for a number": (("--target", "two", "0", "0"), "number"),
    "inside the rover": (("--target", "0", "0", "-0.8"), "inside the rover"),
    "no such tool": (("--tool", "spoon"), "drill, drt, mahli, apxs"),
    "a tool that cannot touch": (("--tool", "portion"), "contact switches"),
    "too much roll": (("--tilt-roll", "30.1"), "up to 30 deg"),
    "too much of both": (("--tilt-roll", "25", "--tilt-pitch", "25"), "34.8 deg"),
    "no such arm": (("--arm", "as-built"), "as-built:SEED"),
    "negative seed": (("--seed", "-1"), "negative"),
    "log in no folder": (("--log", "nowhere/run.mcap"), "nowhere"),
    "log is a folder": (("--log", "."), "directory"),
    "picture in no folder": (("--picture", "nowhere/p.png"), "nowhere"),
    "picture of another kind": (("--picture", "p.jpg"), ".png"),
    "params missing": (("--params", "none.toml"), "none.toml"),
    "params beyond limits": (("--params", "beyond.toml"), "joints.elbow.speed_rad_s"),
    "params unknown": (("--params", "unknown.toml"), "joints.elbow.spede_rad_s"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_a_sentence_and_status_2_and_writes_nothing(tmp_path, case):
    (tmp_path / "beyond.toml").write_text(PARAMS_BEYOND)
    (tmp_path / "unknown.toml").write_text(PARAMS_UNKNOWN)
    before = sorted(tmp_path.iterdir())
    words, said = BAD[case]
    log = () if "--log" in words else ("--log", "run.mcap")
    done = marsarm(tmp_path, "place", *log, *words)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert sorted(tmp_path.iterdir()) == before


def test_bad_input_with_json_is_still_one_document(tmp_path):
    done = marsarm(tmp_path, "place", "--json", "--tool", "spoon")
    assert done.returncode == 2
    assert "spoon" in json.loads(done.stdout)["error"]


@pytest.fixture(scope="module")
def defaults(tmp_path_factory):
    folder = tmp_path_factory.mktemp("defaults")
    return folder, marsarm(folder, "place", "--json", "--log", "run.mcap")


def test_the_defaults_show_a_good_placement(defaults):
    folder, done = defaults
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["outcome"] == "done"
    assert report["error_mm"]["total"] < 1.0
    assert report["error_mm"].keys() >= {"total", "lateral", "normal"}
    assert report["axis_error_deg"] < 0.2
    assert report.keys() >= {"branch", "duration_s", "realtime_factor", "evrs", "log"}
    assert (folder / report["picture"]).stat().st_size > 10_000


def test_the_log_holds_every_cycle_and_the_truth_apart(defaults):
    folder, done = defaults
    log = read_log(folder / "run.mcap")
    cycles = round(json.loads(done.stdout)["duration_s"] * 64)
    assert not log.truncated
    assert len(log["/sensors"]) == len(log["/drive"]) == len(log["/joint"]) == len(log["/truth"]) == cycles
    assert [entry.name for entry in log.evrs] == [evr["name"] for evr in json.loads(done.stdout)["evrs"]]


def test_a_table_with_units_and_the_path_of_the_picture_for_people(tmp_path):
    done = marsarm(tmp_path, "place", "--picture", "here.png", "--arm", "calibrated:1", "--tilt-pitch", "10")
    assert done.returncode == 0, done.stderr
    for word in ("total mm", "axis deg", "in contact", "branch", "here.png"):
        assert word in done.stdout


def test_a_target_without_a_surface_ends_as_a_fault_with_the_brakes_on(tmp_path):
    done = marsarm(tmp_path, "place", "--no-surface", "--no-picture", "--json", "--log", "run.mcap")
    assert done.returncode == 3
    report = json.loads(done.stdout)
    assert report["outcome"] == "faulted"
    assert report["error_mm"] is None
    assert "NoContact" in [evr["name"] for evr in report["evrs"]]
    assert "Retract accepted" not in [evr["message"] for evr in report["evrs"]]
    log = read_log(tmp_path / "run.mcap")
    assert not log["/drive"]["brake_release"][-1].any()
    assert not log["/drive"]["power_on"][-1].any()


def test_help_comes_with_an_example(tmp_path):
    done = marsarm(tmp_path, "place", "--help")
    assert done.returncode == 0
    assert "Example: marsarm place" in done.stdout
