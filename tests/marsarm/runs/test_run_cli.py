"""Tests of `marsarm run` and `marsarm run --list` as a user runs them."""

import json

import pytest

from marsarm.telemetry.read import read_log
from sim.scenario.file import built_in_scenarios
from tests.marsarm.command import largest_file, marsarm, marsarm_process

SHORT = """\
title = "A short move"
summary = "Turn the turret a little."
start = "ready"

[[command]]
type = "MOVE_JOINT"
joint = "turret"
angle_deg = 95

[[check]]
type = "done"
"""
BEYOND = SHORT.replace("angle_deg = 95", "angle_deg = 390")
FAR = """\
title = "A placement that is too far away"
summary = "Place the APXS."

[world.surface]
position_m = [3.4, 0.0, -0.2]
normal = [0.0, 0.0, -1.0]

[[command]]
type = "UNSTOW"

[[command]]
type = "PLACE_TOOL"
tool = "apxs"
position_m = [3.4, 0.0, -0.2]
approach = [0.0, 0.0, 1.0]

[[check]]
type = "done"
"""
REFUSED = SHORT + '\n[[command]]\ntype = "CALIBRATE"\njoint = "elbow"\n'
TILTED = SHORT.replace(
    "[[command]]", '[[command]]\ntype = "SET_TILT"\nroll_deg = 10\npitch_deg = 0\n\n[[command]]'
)
MISSED = SHORT + '\n[[check]]\ntype = "stowed"\n'
CUT = SHORT + '\n[[fault]]\ntype = "POWER_LOSS"\nduring = 1\nafter_s = 1\n'
WRONG = SHORT.replace("angle_deg", "angle").replace('"turret"', '"tower"')

BAD = {
    "no such scenario": (("samplin",), "samplin: there is no such scenario; did you mean sampling?"),
    "no such file": (("none.toml",), "none.toml: cannot be read"),
    "a wrong file": (("wrong.toml",), "wrong.toml:7: joint: 'tower' is not known; there are azimuth"),
    "a wrong file, second line": (
        ("wrong.toml",),
        "wrong.toml:8: angle: has no unit; write angle_rad or angle_deg",
    ),
    "no such arm": (("short.toml", "--arm", "as-built"), "as-built:SEED"),
    "no arm": (("short.toml", "--arm", ""), "as-built:SEED"),
    "a joint beyond its limit": (
        ("beyond.toml",),
        "beyond.toml: command 1, MOVE_JOINT: joint turret: 390.0 deg",
    ),
    "a place out of reach": (("far.toml",), "far.toml: command 2, PLACE_TOOL: apxs: the target: "),
    "a tilt that the IMU contradicts": (
        ("tilted.toml",),
        "tilted.toml: command 1, SET_TILT: the IMU reads gravity 0.1745 rad from there, at most",
    ),
    "no such parameters": (("short.toml", "--params", "none.toml"), "none.toml"),
    "parameters of another arm": (
        ("short.toml", "--params", "arm7.toml"),
        "of the arm as-built:7, not of nominal",
    ),
    "too much tilt": (("short.toml", "--tilt", "25", "25"), "34.8 deg"),
    "NaN tilt": (("short.toml", "--tilt", "nan", "0"), "finite"),
    "negative seed": (("short.toml", "--seed", "-1"), "is below 0"),
    "log of another kind": (("short.toml", "--log", "run.png"), "must end in .mcap"),
    "log over the scenario": (("short.toml", "--log", "short.toml"), "the file of scenario"),
    "movie of another kind": (("short.toml", "--movie", "m.png"), "must end in .gif"),
    "picture in no folder": (("short.toml", "--picture", "nowhere/p.png"), "nowhere"),
    "a log in no folder": (("short.toml", "--log", "nowhere/run.mcap"), "nowhere"),
    "a wish for a full disk": (("short.toml", "--when-disk-full", "cry"), "'cry' is not known; there are"),
}


@pytest.fixture
def folder(tmp_path):
    for name, text in (
        ("short", SHORT),
        ("beyond", BEYOND),
        ("far", FAR),
        ("arm7", 'arm_name = "as-built:7"\n'),
        ("refused", REFUSED),
        ("tilted", TILTED),
        ("missed", MISSED),
        ("cut", CUT),
        ("wrong", WRONG),
    ):
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_a_sentence_and_status_2_and_writes_nothing(folder, case):
    before = sorted(folder.iterdir())
    words, said = BAD[case]
    done = marsarm(folder, "run", *words)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert sorted(folder.iterdir()) == before


def test_bad_input_with_json_is_still_one_document(folder):
    done = marsarm(folder, "run", "wrong.toml", "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["error"].splitlines()[1].startswith("wrong.toml:7: joint:")
    assert done.stderr.strip() == json.loads(done.stdout)["error"]


def test_a_run_that_passes_says_what_was_measured_and_keeps_what_was_asked_for(folder):
    words = ("--arm", "calibrated:1", "--tilt", "3", "-4", "--log", "run.mcap", "--movie", "run.gif")
    done = marsarm(folder, "run", "short.toml", "--json", "--picture", "run.png", *words)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["scenario"], report["outcome"], report["passed"]) == ("short", "done", True)
    assert (report["arm"], report["tilt_deg"]) == (
        "calibrated:1",
        {"roll": pytest.approx(3), "pitch": pytest.approx(-4)},
    )
    (check,) = report["checks"]
    assert check == {
        "check": "done",
        "name": "every command carried out",
        "value": 1.0,
        "unit": None,
        "low": 1.0,
        "high": 1.0,
        "passed": True,
    }
    log = read_log(folder / "run.mcap")
    assert len(log["/joint"]) == len(log["/truth"]) == round(report["duration_s"] * 64)
    assert [entry.name for entry in log.evrs] == [evr["name"] for evr in report["evrs"]]
    for name in ("run.gif", "run.png"):
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
    assert f"nominal arm: {outcome}, NOT passed" in words
    assert said in words
    assert [path.name for path in folder.iterdir() if path.suffix != ".toml"] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wish", "status", "outcome", "passed"), [("go-on", 0, "done", True), ("stop", 3, "stopped", False)]
)
def test_a_full_disk_ends_the_run_or_does_not_as_asked_and_an_event_tells(
    folder, wish, status, outcome, passed
):
    words = ("run", "short.toml", "--json", "--log", "run.mcap", "--when-disk-full", wish)
    with largest_file(100_000):
        done = marsarm(folder, *words)
    assert done.returncode == status, done.stderr
    report = json.loads(done.stdout)
    assert (report["outcome"], report["passed"]) == (outcome, passed)
    said = report["evrs"][-1]
    assert (said["name"], said["severity"]) == ("LogNotWritten", "WARNING_HI")
    assert "File too large" in said["message"]
    assert ("MoveJoint aborted" in [evr["message"] for evr in report["evrs"]]) == (wish == "stop")
    log = read_log(folder / "run.mcap")
    assert log.truncated
    assert len(log["/joint"]) == round(64 * said["fields"]["from_s"])


def test_the_scenarios_are_listed_with_a_line_each(tmp_path):
    done = marsarm_process(tmp_path, "run", "--list")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(built_in_scenarios())
    listed = json.loads(marsarm(tmp_path, "run", "--list", "--json").stdout)["scenarios"]
    assert [scenario["name"] for scenario in listed] == list(built_in_scenarios())
    assert all(scenario["summary"] in line for scenario, line in zip(listed, lines, strict=True))
    assert "TOOL_CHANGE" in {scenario["name"]: scenario for scenario in listed}["tool-change"]["commands"]


def test_help_comes_with_an_example(tmp_path):
    done = marsarm(tmp_path, "run", "--help")
    assert done.returncode == 0
    assert "Example: marsarm run" in done.stdout
