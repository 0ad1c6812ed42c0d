"""`marsarm replay` as a user meets it."""

import json

import pytest

from tests.marsarm.command import marsarm, marsarm_process
from tests.replay.remake import FOLDER, make
from tests.replay.runs import RUNS

LOG = str(FOLDER / "fault.mcap")
SLOWER = "[joints.turret]\nspeed_rad_s = 0.02\n"

BAD = {
    "no such file": (("none.mcap",), "none.mcap: cannot be read"),
    "no log": (("other.toml",), "other.toml: not an MCAP file"),
    "no such channel": ((LOG, "--channel", "/motor*"), "channel: nothing is called '/motor*'"),
    "no such parameters": ((LOG, "--params", "none.toml"), "none.toml: cannot be read"),
    "parameters of another kind": ((LOG, "--params", "wrong.toml"), "speed: is not known"),
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "other.toml").write_text(SLOWER)
    (tmp_path / "wrong.toml").write_text("[joints.turret]\nspeed = 1\n")
    return tmp_path


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_a_sentence_and_status_2(folder, case):
    words, message = BAD[case]
    done = marsarm(folder, "replay", *words)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())
    assert (done.stdout, "Traceback" in done.stderr) == ("", False)


def test_bad_input_with_json_is_still_one_document(folder):
    done = marsarm(folder, "replay", "other.toml", "--json")
    assert done.returncode == 2
    assert "not an MCAP file" in json.loads(done.stdout)["error"]


def test_the_same_is_status_0(folder):
    done = marsarm(folder, "replay", LOG)
    assert done.returncode == 0, done.stderr
    assert "117 ticks, 1.8 s, 26 channels" in done.stdout
    assert done.stderr == ""


@pytest.fixture(scope="module")
def log_of_today(tmp_path_factory) -> str:
    (fault,) = (run for run in RUNS if run.name == "fault")
    return str(make(fault, tmp_path_factory.mktemp("today")))


def test_a_difference_is_status_3_and_events_come_first(folder, log_of_today):
    done = marsarm(folder, "replay", log_of_today, "--params", "other.toml", "--channel", "/drive.*")
    assert done.returncode == 3
    labels = [line.split()[0] for line in done.stdout.splitlines()]
    assert labels.index("parameter") < labels.index("event") < labels.index("channel")
    assert "/drive.setpoint_rate_rad_s[4]: from tick" in done.stdout


def test_a_difference_as_a_document(folder, log_of_today):
    done = marsarm_process(folder, "replay", log_of_today, "--params", "other.toml", "--json")
    assert done.returncode == 3
    document = json.loads(done.stdout)
    assert document["evrs"][0]["recorded"]["name"] == "Booted"
    assert {"channel", "first_tick", "ticks", "greatest", "waveform"} <= document["channels"][0].keys()
