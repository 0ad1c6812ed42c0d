"""`marsarm log ...` as a user meets it."""

import json

import pytest

from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import read_log
from tests.marsarm.command import marsarm
from validation.speed import record_log

CYCLES = 130


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return record_log(tmp_path_factory.mktemp("log") / "run.mcap", CYCLES, 1).read_bytes()


@pytest.fixture
def folder(tmp_path, written):
    (tmp_path / "run.mcap").write_bytes(written)
    begin, _ = read_records(written).chunks[60]
    broken = bytearray(written)
    broken[begin + 80] ^= 8
    (tmp_path / "broken.mcap").write_bytes(broken)
    (tmp_path / "cut.mcap").write_bytes(written[: begin + 50])
    return tmp_path


def run_json(folder, *words):
    ran = marsarm(folder, "log", *words, "--json")
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def test_a_log_cut_short_is_said_to_be(folder):
    found = run_json(folder, "info", "cut.mcap")
    assert not found["closed"]
    assert 0 < found["cycles"] < CYCLES
    assert "cut short" in marsarm(folder, "log", "info", "cut.mcap").stdout


def test_channels_of_a_part(folder):
    found = run_json(folder, "info", "run.mcap", "/joint/tick", "--from", "0.5", "--to", "1")["channels"]
    assert [(one["messages"], one["min"], one["max"]) for one in found] == [(32, 32, 63)]


def test_one_number_is_a_channel_and_both_spellings_are_taken(folder):
    values = read_log(folder / "run.mcap")["/joint"]["motor_rad"][:, 2]
    for pattern in ("/joint.motor_rad[2]", "/joint/motor_rad[2]"):
        (found,) = run_json(folder, "info", "run.mcap", pattern)["channels"]
        assert (found["channel"], found["type"]) == ("/joint.motor_rad[2]", "float64")
        assert (found["min"], found["max"]) == (values.min(), values.max())


def test_plot_draws_a_picture(folder):
    found = run_json(
        folder, "plot", "run.mcap", "/joint/motor_rad*", "/joint/mode", "/truth/R_RT", "--out", "p.png"
    )
    assert found["channels"] == ["/joint.motor_rad", "/joint.mode", "/truth.R_RT"]
    assert (folder / "p.png").read_bytes().startswith(b"\x89PNG")


def test_recover_saves_what_is_undamaged_and_says_what_is_lost(folder):
    found = run_json(folder, "recover", "broken.mcap", "good.mcap")
    assert found["saved"]["/joint"] == CYCLES - 1
    assert run_json(folder, "info", "good.mcap")["lost"] == found["lost"]
    assert "recovered from a damaged one" in marsarm(folder, "log", "info", "good.mcap").stdout
    assert "recovered" not in marsarm(folder, "log", "info", "run.mcap").stdout


def test_what_stands_behind_a_log_is_said_by_every_verb(folder, written):
    (folder / "two.mcap").write_bytes(written + written)
    found = run_json(folder, "info", "two.mcap")
    assert (found["closed"], found["trailing_bytes"], found["cycles"]) == (True, len(written), CYCLES)
    for words in (("export", "two.mcap", "tables"), ("info", "two.mcap", "*")):
        assert "after the end of the log" in marsarm(folder, "log", *words).stderr
    assert "after the end of the log" in run_json(folder, "recover", "two.mcap", "g.mcap")["notes"][0]


@pytest.mark.parametrize("verb", [["export", "--topic", "/joint"], ["plot", "/joint/mode", "--out"]])
def test_a_log_is_never_replaced_by_what_is_made_of_it(folder, written, verb):
    for name in ("j.parquet", "j.csv", "j.png"):
        (folder / name).write_bytes(written)
        ran = marsarm(folder, "log", verb[0], name, *verb[1:], name)
        assert ran.returncode == 2
        assert (folder / name).read_bytes() == written


@pytest.mark.parametrize("verb", ["info", "plot", "export", "recover"])
def test_every_verb_has_help_with_an_example(folder, verb):
    ran = marsarm(folder, "log", verb, "--help")
    assert ran.returncode == 0
    assert f"Example: marsarm log {verb}" in " ".join(ran.stdout.split())


def test_brackets_are_printed_as_they_are(folder):
    (folder / "run.mcap").rename(folder / "run[bold].mcap")
    found = marsarm(folder, "log", "info", "run[bold].mcap", "/joint.motor_rad")
    assert "float64[5]" in found.stdout
    drawn = marsarm(folder, "log", "plot", "run[bold].mcap", "/joint.motor_rad", "--out", "a[bold].png")
    assert "a[bold].png" in drawn.stdout
