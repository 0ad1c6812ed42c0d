"""Tests of `marsarm place` as a user runs it: output, errors and files."""

import json

import pytest

from marsarm.telemetry.read import read_log
from tests.marsarm.command import largest_file, marsarm, marsarm_process

PARAMS_BEYOND = "[joints.elbow]\nspeed_rad_s = 5.0\n"
PARAMS_UNKNOWN = "[joints.elbow]\nspede_rad_s = 0.01\n"


PARAMS_GOOD = "[joints.elbow]\nspeed_rad_s = 0.01\n"
PARAMS_THROUGH = "[poses]\nunstow_via_rad = [[-3.0, 0.0, 0.0, 0.0, 0.0]]\n"
PARAMS_DATE = "[joints.elbow]\nspeed_rad_s = 2012-08-06\n"


BAD = {
    "unreachable": (("--target", "9", "9", "9"), "out of reach"),
    "beyond every limit": (
        ("--target", "1.3", "-1", "-0.1", "--normal", "0", "1", "0"),
        "joint elevation: about 12",
    ),
    "normal without length": (("--normal", "0", "0", "0"), "no direction"),
    "normal next to nothing": (("--normal", "0", "2e-9", "0"), "normal: 0 2e-09 0 has no direction"),
    "normal too long for a square": (("--normal", "1e200", "0", "1e200"), "cannot be reached"),
    "too far for a square": (("--target", "1e200", "0", "0"), "target: 1e+200 0 0 m is farther than 20 m"),
    "NaN target": (("--target", "nan", "0", "0"), "finite"),
    "infinite normal": (("--normal", "0", "inf", "0"), "finite"),
    "NaN tilt": (("--tilt-roll", "nan"), "finite"),
    "text for a number": (("--target", "two", "0", "0"), "number"),
    "inside the rover": (("--target", "0", "0", "-0.8"), "inside the rover"),
    "no such tool": (("--tool", "spoon"), "drill, drt, mahli, apxs"),
    "a tool that cannot touch": (("--tool", "portion"), "contact switches"),
    "too much roll": (("--tilt-roll", "30.1"), "up to 30 deg"),
    "a hair too much roll": (("--tilt-roll", "30.0001"), "by 30.0001 deg"),
    "a whole turn": (("--tilt-pitch", "-360"), "by 360 deg"),
    "too much of both": (("--tilt-roll", "25", "--tilt-pitch", "25"), "34.8 deg"),
    "no such arm": (("--arm", "as-built"), "as-built:SEED"),
    "negative seed": (("--seed", "-1"), "is below 0"),
    "log in no folder": (("--log", "nowhere/run.mcap"), "nowhere"),
    "log is a folder": (("--log", "folder.mcap"), "this is a folder"),
    "log of another kind": (("--log", "run.png"), "must end in .mcap"),
    "log over params": (("--params", "good.toml", "--log", "./good.toml"), "the file of params"),
    "log over linked params": (("--params", "link.mcap", "--log", "good.toml"), "the file of params"),
    "picture over log": (("--log", "a.png", "--picture", "a.png"), "the file of log"),
    "movie over picture": (("--picture", "a.png", "--movie", "folder.mcap/../a.png"), "the file of picture"),
    "picture in no folder": (("--picture", "nowhere/p.png"), "nowhere"),
    "picture of another kind": (("--picture", "p.jpg"), ".png"),
    "picture with a long name": (("--picture", "p" * 300 + ".png"), "too long"),
    "picture to a link to nothing": (("--picture", "dangling.png"), "link to nothing"),
    "movie of another kind": (("--movie", "m.png"), "movie m.png: its name must end in .gif"),
    "params with a date": (("--params", "date.toml"), "joints.elbow.speed_rad_s: 2012-08-06 is a date"),
    "unstowing through the rover": (("--params", "through.toml"), "from the stowed to the ready pose"),
    "params missing": (("--params", "none.toml"), "none.toml"),
    "params beyond limits": (("--params", "beyond.toml"), "joints.elbow.speed_rad_s"),
    "params unknown": (("--params", "unknown.toml"), "joints.elbow.spede_rad_s"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_a_sentence_and_status_2_and_writes_nothing(tmp_path, case):
    (tmp_path / "beyond.toml").write_text(PARAMS_BEYOND)
    (tmp_path / "unknown.toml").write_text(PARAMS_UNKNOWN)
    (tmp_path / "through.toml").write_text(PARAMS_THROUGH)
    (tmp_path / "date.toml").write_text(PARAMS_DATE)
    (tmp_path / "good.toml").write_text(PARAMS_GOOD)
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "link.mcap").symlink_to("good.toml")
    (tmp_path / "dangling.png").symlink_to("nothing")
    before = sorted(tmp_path.iterdir())
    words, said = BAD[case]
    log = () if "--log" in words else ("--log", "run.mcap")
    done = marsarm(tmp_path, "place", *log, *words)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert "Warning" not in done.stderr
    assert done.stdout == ""
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--tool", "spoon"), "spoon"),
        (("--target", "a", "b", "c"), "'--target': takes 3 numbers"),
        (("--target", "1"), "3 arguments"),
        (("--sped", "1"), "--sped"),
    ],
    ids=["no such tool", "no numbers", "too few numbers", "no such option"],
)
def test_bad_input_with_json_is_still_one_document(tmp_path, words, said):
    done = marsarm(tmp_path, "place", "--json", *words)
    assert done.returncode == 2
    assert said in json.loads(done.stdout)["error"]
    assert done.stderr.strip() == json.loads(done.stdout)["error"]


@pytest.fixture(scope="module")
def defaults(tmp_path_factory):
    folder = tmp_path_factory.mktemp("defaults")
    return folder, marsarm(folder, "place", "--json", "--log", "run.mcap")


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_log_holds_every_cycle_and_the_truth_apart(defaults):
    folder, done = defaults
    log = read_log(folder / "run.mcap")
    cycles = round(json.loads(done.stdout)["duration_s"] * 64)
    assert not log.truncated
    assert len(log["/sensors"]) == len(log["/drive"]) == len(log["/joint"]) == len(log["/truth"]) == cycles
    assert [entry.name for entry in log.evrs] == [evr["name"] for evr in json.loads(done.stdout)["evrs"]]


@pytest.mark.slow
def test_a_table_with_units_and_the_path_of_the_picture_for_people(tmp_path):
    done = marsarm(tmp_path, "place", "--picture", "here.png", "--arm", "calibrated:1", "--tilt-pitch", "10")
    assert done.returncode == 0, done.stderr
    for word in ("total mm", "axis deg", "in contact", "branch", "here.png"):
        assert word in done.stdout


@pytest.fixture(scope="module")
def no_surface(tmp_path_factory):
    folder = tmp_path_factory.mktemp("no_surface")
    words = ("place", "--no-surface", "--json", "--log", "run.mcap")
    return folder, marsarm_process(folder, *words, MUJOCO_GL="osmesa")


@pytest.mark.slow
def test_a_target_without_a_surface_ends_as_a_fault_with_the_brakes_on(no_surface):
    folder, done = no_surface
    assert done.returncode == 3, done.stderr
    report = json.loads(done.stdout)
    assert report["outcome"] == "faulted"
    assert report["error_mm"] is None
    assert "NoContact" in [evr["name"] for evr in report["evrs"]]
    assert "Retract accepted" not in [evr["message"] for evr in report["evrs"]]
    log = read_log(folder / "run.mcap")
    assert not log["/drive"]["brake_release"][-1].any()
    assert not log["/drive"]["power_on"][-1].any()


@pytest.mark.slow
def test_a_setting_of_opengl_that_is_not_there_does_not_stop_a_run(no_surface):
    folder, done = no_surface
    assert (folder / json.loads(done.stdout)["picture"]).stat().st_size > 10_000


@pytest.mark.slow
def test_a_full_disk_stops_the_arm_if_so_asked_and_is_told(tmp_path):
    words = ("place", "--json", "--no-picture", "--log", "run.mcap", "--when-disk-full", "stop")
    with largest_file(500_000):
        done = marsarm(tmp_path, *words)
    assert done.returncode == 3, done.stderr
    report = json.loads(done.stdout)
    assert report["outcome"] == "stopped"
    assert report["picture"] is None
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
    kept = read_log(tmp_path / "run.mcap")
    seconds = len(kept["/joint"]) / 64
    assert kept.truncated
    assert seconds > 2
    assert f"not recorded from {seconds:.2f} s on (File too large)" in report["log_problem"]


@pytest.mark.parametrize("value", ["nonsense", "egl", "off", " OFF "])
def test_no_setting_of_opengl_stops_the_import(tmp_path, value):
    done = marsarm_process(tmp_path, "place", "--tool", "spoon", MUJOCO_GL=value)
    assert (done.returncode, done.stderr.split(":")[0]) == (2, "tool")


def test_help_comes_with_an_example(tmp_path):
    done = marsarm(tmp_path, "place", "--help")
    assert done.returncode == 0
    assert "Example: marsarm place" in done.stdout
