"""Diagnosis of a measured UR10: the same effects at the same joints in two series, and no temperature."""

import pytest

from helpers.real_robots import repository_file
from simgap.serial_arm.files import read_arm, read_series
from simgap.serial_arm.tracker import diagnose_tracker


@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "mapping", "held_out_mm"),
    [
        ("series_a_grid.csv", "series_a.toml", 0.12),
        ("series_c_random_poses.csv", "series_c.toml", 0.10),
    ],
)
def test_the_joints_have_the_effects_that_the_calibration_shows(real_data, table, mapping, held_out_mm):
    arm = read_arm(repository_file("models/robots/ur10/arm.toml"))
    series = read_series(
        arm, real_data / "ur10-tracker" / table, repository_file(f"models/robots/ur10/{mapping}")
    )
    found = diagnose_tracker(arm, series)
    named = {(one.effect, one.place) for one in found.findings}
    assert {place for effect, place in named if effect == "periodic joint error"} == {
        one.name for one in arm.links
    }
    assert {place for effect, place in named if effect == "joint compliance"} == {"shoulder_lift", "elbow"}
    assert ("direction hysteresis", "shoulder_pan") in named
    assert found.errors[0].explained * 1e3 < held_out_mm
    assert "air temperature" in {one.effect for one in found.rejected}
    assert "temperature" not in {one.depends_on for one in found.remaining}
