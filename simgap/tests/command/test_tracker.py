"""Command `simgap diagnose` with poses that a tracker measured."""

import json
import re

import pytest

from helpers.command import run_simgap
from helpers.serial_synthetic import MAPPING, POSITION_M, write
from simgap.command.diagnosis import diagnose_robot
from simgap.command.request import DiagnoseRequest
from simgap.common.errors import BadRequest, RobotError
from simgap.serial_arm.files import read_arm
from simgap.serial_arm.model import TERMS

ROBOT = 'name = "made up"\nserial_arm = "arm.toml"\n[poses]\n"poses.csv" = "mapping.toml"\n'


def write_robot(folder):
    """Write arm, poses, mapping and robot file."""
    write(folder)
    (folder / "robot.toml").write_text(ROBOT)


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """Run the command with all its files; return its folder and its result."""
    folder = tmp_path_factory.mktemp("tracker")
    write_robot(folder)
    options = ("--patch", "found", "--report", "page.html", "--json")
    return folder, run_simgap(folder, "diagnose", "robot.toml", "poses.csv", *options)


def test_the_document_names_effects_at_joints(ended):
    _, done = ended
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["kind"] == "tracker"
    assert {one["effect"] for one in document["findings"]} >= {"periodic joint error"}


def test_the_patched_arm_has_the_effects_and_says_where_it_is_from(ended):
    folder, _ = ended
    patched = folder / "found" / "arm.toml"
    assert "poses.csv sha256" in patched.read_text()
    before, after = read_arm(folder / "arm.toml"), read_arm(patched)
    assert [one.name for one in after.links] == [one.name for one in before.links]
    assert after.links != before.links


def test_the_terms_and_the_whole_calibration_are_in_the_document(ended):
    folder, done = ended
    found = json.loads(done.stdout)["calibration"]
    assert [one["terms"][-1] for one in found["models"][1:]] == list(TERMS)
    worth = {one["terms"][-1]: one["significant"] for one in found["models"][1:]}
    assert worth["geometry"]
    assert worth["periodic"]
    held_out = [one["held_out_rms_m"] for one in found["models"]]
    assert found["held_out_rms_m"] == held_out[-1] < 0.5 * held_out[1] < 0.5 * held_out[0]
    assert found["temperature"]["explains"] == "nothing"
    assert found["fit"]["converged"]
    links = read_arm(folder / "arm.toml").links
    assert [one["name"] for one in found["joints"]] == [one.name for one in links]


def test_a_calibrated_arm_is_judged_again_without_terms(ended):
    folder, _ = ended
    (folder / "again.toml").write_text(ROBOT.replace("arm.toml", "found/calibrated.toml"))
    done = run_simgap(folder, "diagnose", "again.toml", "poses.csv", "--terms", "none", "--json")
    document = json.loads(done.stdout)
    assert document["findings"] == document["base"] == []
    assert document["calibration"]["held_out_rms_m"] < 1.2 * POSITION_M * 3**0.5


def test_nested_shows_what_each_term_explains(ended):
    words = ("--terms", "geometry,periodic", "--fit-share", "0.4", "--nested")
    done = run_simgap(ended[0], "diagnose", "robot.toml", "poses.csv", *words)
    assert "120 poses fitted, 180 held out" in done.stdout
    assert re.findall(r"^│ \+ (\w+)", done.stdout, re.M) == ["geometry", "periodic"]
    assert "hysteresis" in done.stdout


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"split": "fit_a"}, BadRequest, "split: is for logs"),
        ({"held_out": ("poses.csv",)}, BadRequest, "held-out: is for logs"),
        ({"logs": ("poses.csv", "poses.csv")}, BadRequest, "logs: 2 tables of poses; give one"),
        ({"logs": ("others.csv",)}, RobotError, "poses: has no mapping for others.csv; has poses.csv"),
        ({"terms": "geometri"}, BadRequest, "terms: 'geometri' is not known; there are geometry"),
        ({"terms": "all,periodic"}, BadRequest, "all and none stand alone"),
        ({"fit_share": 0.01}, BadRequest, "fit-share: 0.01 is not within 0.05 .. 0.95"),
        ({"patch": "."}, BadRequest, "this is the file of serial_arm too"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_writes_nothing(tmp_path, changes, error, words):
    write_robot(tmp_path)
    before = {one.name: one.read_bytes() for one in tmp_path.iterdir()}
    logs = tuple(tmp_path / name for name in changes.pop("logs", ("poses.csv",)))
    paths = {key: tmp_path / value if key == "patch" else value for key, value in changes.items()}
    with pytest.raises(error, match=re.escape(words)):
        diagnose_robot(DiagnoseRequest(tmp_path / "robot.toml", logs, **paths))
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"made up"', '"UR10"'), "its table is of the arm 'UR10'"),
        (('"joint2"]', '"joint2", "air"]'), "joints: 4 columns; the arm made up has 3 joints"),
    ],
)
def test_a_wrong_mapping_is_one_sentence(tmp_path, change, words):
    write_robot(tmp_path)
    (tmp_path / "mapping.toml").write_text(MAPPING.replace(*change))
    with pytest.raises(RobotError, match=re.escape(words)):
        diagnose_robot(DiagnoseRequest(tmp_path / "robot.toml", (tmp_path / "poses.csv",)))
