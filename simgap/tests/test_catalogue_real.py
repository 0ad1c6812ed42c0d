"""Catalogues of the real robots: a table under the SO-101, second encoders of the KR300, one servo."""

import pytest

from helpers.real_robots import robot_path
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.effects.forces import PlaneContact
from simgap.loading import load
from simgap.robot import Robot


def effects_of(folder, *tables):
    robot = Robot.from_toml(robot_path(folder))
    logs = load(robot, tables)
    return robot, catalogue(robot, logs), base_effects(robot, logs)


@pytest.mark.real_data
def test_the_table_of_the_so101_is_within_the_bounds_of_the_plane(real_data):
    _, effects, base = effects_of("so101", real_data / "so101" / "so101.parquet")
    (plane,) = (one for one in effects if isinstance(one, PlaneContact))
    assert plane.lowest_m < -0.050
    assert plane.lowest_m + plane.high_m > -0.040
    assert len(base) == 24


@pytest.mark.real_data
def test_axes_of_the_kr300_with_a_second_encoder_have_periodic_errors(real_data):
    tables = [real_data / "kr300" / f"kr300_{batch}.parquet" for batch in "AB"]
    _, effects, _ = effects_of("kr300", *tables)
    assert {one.place for one in effects if one.name == "periodic joint error"} == {"a1", "a2", "a3"}
    assert not any(one.encoder_is_at_output for one in effects if one.name == "joint compliance")


@pytest.mark.real_data
def test_the_pendulum_warms_and_has_no_neighbour(real_data):
    _, effects, base = effects_of("pendulum", real_data / "xl330" / "xl330.parquet")
    names = {one.name for one in effects}
    assert "temperature-dependent friction" in names
    assert "joint coupling" not in names
    assert len(base) == 4
