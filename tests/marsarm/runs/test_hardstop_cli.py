"""Tests of `marsarm hardstop` as a user runs it."""

import json

import PIL.Image
import pytest

from fsw.dictionary.enums import Joint
from sim.arms import nominal_params
from tests.marsarm.command import marsarm


def test_one_joint_is_found_and_drawn_and_people_see_a_table_and_what_was_said(tmp_path):
    words = ("--arm", "as-built:5", "--temperature", "-55", "--picture", "turret.png")
    done = marsarm(tmp_path, "hardstop", "--joint", "turret", *words)
    assert done.returncode == 0, done.stderr
    assert "TURRET calibrated" in done.stdout
    assert "zero error" in done.stdout
    with PIL.Image.open(tmp_path / "turret.png") as image:
        assert image.width > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["turret.png"]


@pytest.mark.slow
def test_every_as_built_joint_finds_its_zero_in_the_cold_one_after_the_other(tmp_path):
    done = marsarm(tmp_path, "hardstop", "--arm", "as-built:3", "--temperature", "-55", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert set(document["joints"]) == {joint.name.lower() for joint in Joint}
    for joint, params in zip(Joint, nominal_params().joints.in_order(), strict=True):
        found = document["joints"][joint.name.lower()]
        assert abs(found["zero_error_mrad"]) < 0.3
        assert abs(found["uncorrected_error_mrad"]) > 1.0  # wind-up is corrected
        assert found["max_torque_Nm"] < params.hardstop_rated_Nm
    assert document["max_current_ratio"] <= 1.0 + 1e-9
    assert "CommandCompleted" in [evr["name"] for evr in document["evrs"]]


def test_a_load_that_hides_the_hardstop_is_refused(tmp_path):
    done = marsarm(tmp_path, "hardstop", "--joint", "elevation", "--scene", "earth", "--json")
    assert done.returncode == 3
    document = json.loads(done.stdout)
    assert (document["outcome"], document["max_current_ratio"]) == ("refused", 0.0)
    assert "gravity presses it on its hardstop" in document["evrs"][-1]["message"]
