"""Command `marsarm calibrate-serial`."""

import json

import PIL.Image
import pytest

from helpers.serial_files import MAPPING, rows, write
from helpers.serial_synthetic import POSITION_M
from marsarm.calibration.request import SerialRequest
from marsarm.calibration.serial.execution import calibrate_serial
from simgap.common.errors import BadRequest, RobotError
from simgap.serial_arm.files import read_arm
from tests.marsarm.command import marsarm, marsarm_process

NAMES = {"arm": "arm.toml", "table": "poses.csv", "mapping": "mapping.toml"}
VERB = ("calibrate-serial", *NAMES.values())


def quiet(*_) -> None:
    """Ignore progress."""


def make_request(folder, **options):
    """Make a request for the files of a folder."""
    return SerialRequest(**{name: folder / file for name, file in NAMES.items()} | options)


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """Run the command as in the documents; return its folder and its result."""
    folder = tmp_path_factory.mktemp("serial")
    write(folder)
    options = ("--nested", "--out", "found.toml", "--picture", "found.png", "--json")
    return folder, marsarm(folder, *VERB, *options)


def test_standard_output_is_one_document(ended):
    _, done = ended
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    document = json.loads(done.stdout)
    assert document["fit"]["converged"]
    assert document["held_out_rms_m"] < 1.2 * POSITION_M * 3**0.5
    assert document["temperature"]["explains"] == "nothing"


def test_the_large_errors_of_the_arm_are_worth_their_terms(ended):
    steps = json.loads(ended[1].stdout)["models"]
    worth = {step["terms"][-1]: step["significant"] for step in steps[1:]}
    assert list(worth) == ["geometry", "compliance", "periodic", "hysteresis"]
    assert worth["geometry"]
    assert worth["periodic"]
    held_out = [step["held_out_rms_m"] for step in steps]
    assert held_out[-1] < 0.5 * held_out[1] < 0.5 * held_out[0]


def test_the_arm_that_was_found_says_where_it_is_from_and_can_be_judged_again(ended):
    folder, done = ended
    found = (folder / "found.toml").read_text()
    assert json.loads(done.stdout)["sha256"]["table"] in found
    assert read_arm(folder / "found.toml").name == "made up"
    again = calibrate_serial(make_request(folder, arm=folder / "found.toml", terms="none"), quiet)
    assert again.models[-1].fresh.rms_m < 1.2 * POSITION_M * 3**0.5


def test_the_picture_shows_every_joint(ended):
    with PIL.Image.open(ended[0] / "found.png") as picture:
        assert picture.size == (1200, 640)


def test_people_read_a_table(tmp_path):
    write(tmp_path)
    done = marsarm_process(tmp_path, *VERB, COLUMNS="120")
    assert done.returncode == 0, done.stderr
    assert "150 poses fitted, 150 held out" in done.stdout
    assert "explains nothing" in done.stdout


def test_the_same_files_give_the_same_bytes(ended):
    folder, done = ended
    again = marsarm(folder, *VERB, "--nested", "--out", "again.toml", "--picture", "found.png", "--json")
    assert again.stdout == done.stdout
    assert (folder / "again.toml").read_bytes() == (folder / "found.toml").read_bytes()


@pytest.mark.parametrize(
    ("option", "change", "said"),
    [
        ({"fit_share": 0.01}, None, "fit-share: 0.01 is not within 0.05 .. 1"),
        ({"terms": "geometri"}, None, "terms: 'geometri' is not known; did you mean geometry?"),
        ({"terms": "all,periodic"}, None, "all and none stand alone"),
        ({"out": "found.txt"}, None, "found.txt: its name must end in .toml"),
        ({"out": "arm.toml"}, None, "this is the file of arm too"),
        ({"table": "none.csv"}, None, "none.csv: there is no such log"),
        ({}, ('"made up"', '"UR10"'), "its table is of the arm 'UR10'"),
        ({}, ('"joint2"]', '"joint2", "air"]'), "joints: 4 columns; the arm made up has 3 joints"),
        ({}, ('unit = "mm"', 'unit = "m"'), "times as far: see that positions have their unit"),
        ({}, ('"XYZ"', '"ZYX"'), "does not turn as the arm's flange does"),
        ({}, ('"joint0", "joint1"', '"joint1", "joint0"'), "does not turn as the arm's flange does"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_is_written(tmp_path, option, change, said):
    write(tmp_path)
    if change is not None:
        (tmp_path / "mapping.toml").write_text(MAPPING.replace(*change))
    before = {one.name: one.read_bytes() for one in tmp_path.iterdir()}
    paths = {k: tmp_path / v if k in ("out", "table") else v for k, v in option.items()}
    with pytest.raises((BadRequest, RobotError)) as error:
        calibrate_serial(make_request(tmp_path, **{"out": tmp_path / "found.toml"} | paths), quiet)
    assert said in str(error.value)
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == before


def test_bad_input_ends_with_status_2_and_one_sentence(tmp_path):
    write(tmp_path, rows(30))
    done = marsarm(tmp_path, *VERB)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "15 poses are too few; 20 or more are wanted\n"
