"""Command `marsarm robot diagnose` with poses that a tracker measured."""

import json
import re

import pytest

from helpers.serial_files import write
from simgap.command.diagnosis import diagnose_robot
from simgap.command.request import RobotDiagnoseRequest
from simgap.common.errors import BadRequest, RobotError
from simgap.serial_arm.files import read_arm
from tests.marsarm.command import marsarm

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
    return folder, marsarm(folder, "robot", "diagnose", "robot.toml", "poses.csv", *options)


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


def test_the_page_opens_with_the_verdict(ended):
    page = (ended[0] / "page.html").read_text()
    assert page.index("Where:") < page.index("How far the error shrinks")


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"split": "fit_a"}, BadRequest, "split: is for logs"),
        ({"held_out": ("poses.csv",)}, BadRequest, "held-out: is for logs"),
        ({"logs": ("poses.csv", "poses.csv")}, BadRequest, "logs: 2 tables of poses; give one"),
        ({"logs": ("others.csv",)}, RobotError, "poses: has no mapping for others.csv; has poses.csv"),
        ({"patch": "."}, BadRequest, "this is the file of serial_arm too"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_writes_nothing(tmp_path, changes, error, words):
    write_robot(tmp_path)
    before = {one.name: one.read_bytes() for one in tmp_path.iterdir()}
    logs = tuple(tmp_path / name for name in changes.pop("logs", ("poses.csv",)))
    paths = {key: tmp_path / value if key == "patch" else value for key, value in changes.items()}
    with pytest.raises(error, match=re.escape(words)):
        diagnose_robot(RobotDiagnoseRequest(tmp_path / "robot.toml", logs, **paths))
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == before
