"""`marsarm replay` as a user meets it."""

import json

import pytest

from tests.marsarm.command import marsarm
from tests.replay.remake import FOLDER, make
from tests.replay.runs import RUNS

LOG = str(FOLDER / "fault.mcap")
SLOWER = "[joints.turret]\nspeed_rad_s = 0.02\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "other.toml").write_text(SLOWER)
    return tmp_path


def test_the_same_is_status_0(folder):
    done = marsarm(folder, "replay", LOG)
    assert done.returncode == 0, done.stderr
    assert "117 ticks, 1.8 s, 26 channels" in done.stdout
    assert done.stderr == ""


@pytest.fixture(scope="module")
def log_of_today(tmp_path_factory) -> str:
    (fault,) = (run for run in RUNS if run.name == "fault")
    return str(make(fault, tmp_path_factory.mktemp("today")))


def test_a_difference_as_a_document(folder, log_of_today):
    done = marsarm(folder, "replay", log_of_today, "--params", "other.toml", "--json")
    assert done.returncode == 3
    document = json.loads(done.stdout)
    assert document["evrs"][0]["recorded"]["name"] == "Booted"
    assert {"channel", "first_tick", "ticks", "greatest", "at_first"} <= document["channels"][0].keys()
