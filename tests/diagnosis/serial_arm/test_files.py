"""Files of arms, mappings and tables: content is read back, and errors are named with their line."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from diagnosis.serial_arm.arm_file import BadArmFile, arm_from_toml, arm_to_toml
from diagnosis.serial_arm.tracker_table import mapping_from_toml, series_from_table
from ground.telemetry.imports.files import BadImport
from tests.diagnosis.serial_arm.synthetic import built_arm, drawn_arm
from tests.ground.calibration.serial.files import MAPPING, rows, text

<<<<<<< HEAD:tests/diagnosis/serial_arm/test_files.py
MODELS = Path(__file__).parents[3] / "models" / "ur10"
=======
MODELS = Path(__file__).parents[4] / "models" / "robots" / "ur10"
>>>>>>> files:tests/ground/calibration/serial/test_files.py


@pytest.mark.parametrize("seed", range(3))
def test_an_arm_comes_back_from_its_file_bit_by_bit(seed):
    arm = built_arm(drawn_arm(5), seed)
    assert arm_from_toml(arm_to_toml(arm, ["about", "it"]), "arm.toml") == arm


def test_the_ur10_of_the_models_has_six_joints_and_the_published_reach():
    arm = arm_from_toml((MODELS / "arm.toml").read_text(), "arm.toml")
    assert len(arm.links) == 6
    assert sum(abs(one.a_m) for one in arm.links) == pytest.approx(1.1843)
    assert sum(one.mass_kg for one in arm.links) == pytest.approx(28.435)


@pytest.mark.parametrize("name", ["series_a.toml", "series_c.toml"])
def test_the_mappings_of_the_models_are_of_the_ur10(name):
    assert mapping_from_toml((MODELS / name).read_text(), name).arm == "UR10"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("d_m = 0.1273", "d = 0.1273"), "arm.toml:10: d: has no unit; write d_m or d_mm"),
        (("d_m = 0.1273", 'd_m = "long"'), "arm.toml:10: d_m: 'long' is not a number"),
        (('name = "elbow"', 'name = "wrist_1"'), "name: 'wrist_1' is taken already; give each link its own"),
        (("orders = 48", "orders = 4800"), "orders: 4800 is outside 0 .. 500"),
        (("[repeatability]", "[repeat]"), "repeat: is not known here"),
        (('name = "UR10"', ""), "name: is missing"),
        (("mass_kg = 7.1", "cos_rad = [1e-4]"), "cos and sin are not equally many"),
    ],
)
def test_what_is_wrong_with_an_arm_is_named(change, line):
    said = (MODELS / "arm.toml").read_text().replace(*change)
    with pytest.raises(BadArmFile) as error:
        arm_from_toml(said, "arm.toml")
    assert line in str(error.value)


def test_an_arm_without_links_is_none():
    with pytest.raises(BadArmFile, match=r"write \[\[link\]\] and its keys below"):
        arm_from_toml('name = "none"', "arm.toml")


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (('unit = "mm"', 'unit = "mn"'), "mapping.toml:13: unit: 'mn' does not fit; did you mean m?"),
        (('unit = "mm"', 'unit = "deg"'), "mapping.toml:13: unit: 'deg' does not fit"),
        (('["x", "y", "z"]', '["x", "y"]'), "columns: 2 given; position takes 3"),
        (('order = "XYZ"', 'order = "RPY"'), "order: 'RPY' is not known"),
        (("[position]", "[place]"), "place: is not known here"),
        (("[position]", "[place]"), "position: is missing"),
    ],
)
def test_what_is_wrong_with_a_mapping_is_named(change, line):
    with pytest.raises(BadImport) as error:
        mapping_from_toml(MAPPING.replace(*change), "mapping.toml")
    assert line in str(error.value)


def test_a_table_has_its_numbers_in_units_of_the_house():
    numbers = rows(5)
    read = series_from_table(text(numbers).encode(), "poses.csv", mapping_from_toml(MAPPING, "m"))
    np.testing.assert_allclose(read.joint_rad, np.radians(numbers[:, :3].T), rtol=1e-8)
    np.testing.assert_allclose(read.X_TM.p, numbers[:, 3:6].T * 1e-3, rtol=1e-8)
    assert read.row.tolist() == [1, 2, 3, 4, 5]
    assert read.direction[:, 0].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(read.direction[:, 1:], np.sign(np.diff(numbers[:, :3], axis=0)).T)


def test_rows_are_put_in_order_of_their_times():
    numbers = rows(4)
    lines = text(numbers).splitlines()
    times = ("2026-01-01 00:00:0" + str(k) for k in (3, 1, 2, 4))
    table = "\n".join(
        [f"when;{lines[0]}", *(f"{t};{line}" for t, line in zip(times, lines[1:], strict=True))]
    )
    timed = '\n[time]\ncolumn = "when"\nformat = "%Y-%m-%d %H:%M:%S"\nsort = true\n'
    read = series_from_table(table.encode(), "poses.csv", mapping_from_toml(MAPPING + timed, "m"))
    assert read.row.tolist() == [2, 3, 1, 4]


def bad_table(table):
    with pytest.raises(BadImport) as error:
        series_from_table(table.encode(), "poses.csv", mapping_from_toml(MAPPING, "m"))
    return str(error.value)


def test_a_target_that_was_not_seen_is_named_by_its_row():
    lines = text(rows(5)).splitlines()
    parts = lines[3].split(";")
    lines[3] = ";".join([*parts[:4], "", *parts[5:]])
    said = bad_table("\n".join(lines))
    assert "poses.csv: row 3, column 'y': has no value; leave poses out" in said


def test_a_tracker_that_lost_its_target_is_found():
    numbers = rows(20)
    numbers[7:11, 3:9] = numbers[6, 3:9]
    assert "row 7, column 'x': the target stands still" in bad_table(text(numbers))


def test_a_column_that_is_not_there_is_named_with_what_there_is():
    said = bad_table(text(rows(3)).replace("joint2", "joint3", 1))
    assert "there is no column 'joint2'; did you mean joint" in said


def test_an_arm_s_file_is_toml():
    assert tomllib.loads(arm_to_toml(drawn_arm(2), ['a "quoted" line']))["name"] == "made up"
