"""Files of arms, mappings and tables: content is read back, and errors are named with their key."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.real_robots import repository_file
from helpers.serial_synthetic import MAPPING, built_arm, drawn_arm, rows, text
from simgap.common.errors import RobotError
from simgap.common.toml import toml_text
from simgap.serial_arm.files import arm_to_toml, read_arm, read_mapping, series_from_table
from simgap.serial_arm.model import UPRIGHT_B_m_s2


def written(folder, name, content):
    """Write a file, and return its path."""
    path = folder / name
    path.write_text(content)
    return path


@pytest.mark.parametrize("seed", range(3))
def test_an_arm_comes_back_from_its_file_bit_by_bit(tmp_path, seed):
    arm = built_arm(drawn_arm(5), seed)
    assert read_arm(written(tmp_path, "arm.toml", arm_to_toml(arm, ["about", "it"]))) == arm


def test_the_ur10_of_the_models_has_six_joints_and_the_published_reach():
    arm = read_arm(repository_file("models/robots/ur10/arm.toml"))
    assert len(arm.links) == 6
    assert arm.links[0].alpha_rad == np.pi / 2
    assert arm.uncertainty.length_m == 1e-3
    assert sum(abs(one.a_m) for one in arm.links) == pytest.approx(1.1843)
    assert sum(one.mass_kg for one in arm.links) == pytest.approx(28.435)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("mass_kg = 7.1", "mas_kg = 7.1"), "arm.toml: link[1].mas_kg: is not known; did you mean mass_kg?"),
        (("d_m = 0.1273", 'd_m = "0.1"'), "arm.toml: link[1].d_m: should be a valid number, not '0.1'"),
        (("d_m = 0.1273", "d_m = 0.1273\nd_mm = 127.3"), "link[1].d_mm: is not known; did you mean d_m?"),
        (('name = "elbow"', 'name = "wrist_1"'), "name 'wrist_1' is taken already; give each link its own"),
        (("orders = 48", "orders = 4800"), "orders: should be less than or equal to 500, not 4800"),
        (("[repeatability]", "[repeat]"), "repeat: is not known; did you mean repeatability?"),
        (('name = "UR10"', ""), "name: is missing"),
        (("mass_kg = 7.1", "cos_rad = [1e-4]"), "cos and sin are not equally many"),
    ],
)
def test_what_is_wrong_with_an_arm_is_named(tmp_path, change, line):
    ur10 = repository_file("models/robots/ur10/arm.toml")
    path = written(tmp_path, "arm.toml", ur10.read_text().replace(*change))
    with pytest.raises(RobotError) as error:
        read_arm(path)
    assert line in str(error.value)


def test_an_arm_without_links_is_none_and_one_without_gravity_in_its_file_stands_upright(tmp_path):
    with pytest.raises(RobotError, match="link: is missing"):
        read_arm(written(tmp_path, "arm.toml", 'name = "none"'))
    arm = read_arm(written(tmp_path, "arm.toml", 'name = "one"\n[[link]]\nname = "joint"'))
    assert arm.gravity_B_m_s2 == UPRIGHT_B_m_s2


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (('unit = "mm"', 'unit = "mn"'), "mapping.toml: position.unit: 'mn' is no unit of length; did you"),
        (('unit = "mm"', 'unit = "deg"'), "mapping.toml: position.unit: 'deg' is no unit of length"),
        (('unit = "deg"', 'unit = "count"'), "joints.unit: 'count' needs a range"),
        (('["x", "y", "z"]', '["x", "y"]'), "position: columns: there are 2; give three"),
        (('order = "XYZ"', 'order = "RPY"'), "rotation: order: should be three axes as XYZ, ZYZ or xyz, not"),
        (('order = "XYZ"', 'order = "XXY"'), "rotation: order: should be three axes"),
        (('order = "XYZ"', ""), "rotation: order: should be three axes"),
        (('order = "XYZ"', 'form = "rotation vector"\norder = "XYZ"'), "order: should be left out"),
        (('order = "XYZ"', 'form = "quaternion"\norder = "wxyz"'), "columns: there are 3; a rotation as"),
        (('order = "XYZ"', 'form = "matrice"'), "rotation.form: should be 'euler', 'rotation vector', 'quat"),
        (
            ('rz"]\nunit = "deg"\norder = "XYZ"', 'rz", "w"]\norder = "wzyx"\nform = "quaternion"'),
            "rotation: order: should be wxyz or xyzw, not 'wzyx'",
        ),
        (('rz"]\nunit = "deg"\norder = "XYZ"', 'rz"]\norder = "XYZ"'), "unit: '' is no unit of angle"),
        (("[position]", "[place]"), "place: is not known"),
        (('[position]\ncolumns = ["x", "y", "z"]\nunit = "mm"', ""), "position: is missing"),
    ],
)
def test_what_is_wrong_with_a_mapping_is_named(tmp_path, change, line):
    path = written(tmp_path, "mapping.toml", MAPPING.replace(*change))
    with pytest.raises(RobotError) as error:
        read_mapping(path)
    assert line in str(error.value)


def series_of(folder, table, more=""):
    """Read the series of a table."""
    mapping = read_mapping(written(folder, "m.toml", MAPPING + more))
    return series_from_table(written(folder, "poses.csv", table), mapping)


def test_a_table_has_its_numbers_in_units_of_the_house(tmp_path):
    numbers = rows(5)
    read = series_of(tmp_path, text(numbers))
    np.testing.assert_allclose(read.joint_rad, np.radians(numbers[:, :3].T), rtol=1e-8)
    np.testing.assert_allclose(read.X_TM.p, numbers[:, 3:6].T * 1e-3, rtol=1e-8)
    assert read.row.tolist() == [1, 2, 3, 4, 5]
    assert read.direction[:, 0].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(read.direction[:, 1:], np.sign(np.diff(numbers[:, :3], axis=0)).T)


def with_times(numbers, times):
    """Format a table with a first column of times."""
    lines = text(numbers).splitlines()
    pairs = zip(times, lines[1:], strict=True)
    return "\n".join([f"when;{lines[0]}", *(f"{time};{line}" for time, line in pairs)])


def test_rows_are_put_in_order_of_their_times(tmp_path):
    times = ("2026-01-01 00:00:0" + str(k) for k in (3, 1, 2, 4))
    timed = '\n[time]\ncolumn = "when"\nformat = "%Y-%m-%d %H:%M:%S"\nsort = true\n'
    assert series_of(tmp_path, with_times(rows(4), times), timed).row.tolist() == [2, 3, 1, 4]


@pytest.mark.parametrize(
    ("times", "more", "said"),
    [
        ("312", "", "row 2, column 'when': is before the row above"),
        (
            ("2026", "now", "2027"),
            'format = "%Y"\nsort = true\n',
            "row 2, column 'when': '.*' is no time as '%Y'",
        ),
    ],
)
def test_times_that_run_backwards_or_have_another_format_are_named_by_their_row(tmp_path, times, more, said):
    with pytest.raises(RobotError, match=said):
        series_of(tmp_path, with_times(rows(3), times), f'\n[time]\ncolumn = "when"\n{more}')


def bad_table(folder, table):
    """Return the error of a table."""
    with pytest.raises(RobotError) as error:
        series_of(folder, table)
    return str(error.value)


def test_a_target_that_was_not_seen_is_named_by_its_row(tmp_path):
    lines = text(rows(5)).splitlines()
    parts = lines[3].split(";")
    lines[3] = ";".join([*parts[:4], "", *parts[5:]])
    said = bad_table(tmp_path, "\n".join(lines))
    assert "poses.csv: row 3, column 'y': has no value; leave poses out" in said


def test_a_tracker_that_lost_its_target_is_found(tmp_path):
    numbers = rows(20)
    numbers[7:11, 3:9] = numbers[6, 3:9]
    assert "row 7: the target stands still" in bad_table(tmp_path, text(numbers))


def test_a_column_that_is_not_there_is_named_with_the_nearest(tmp_path):
    said = bad_table(tmp_path, text(rows(3)).replace("joint2", "joint3", 1))
    assert "has no column 'joint2'" in said
    assert "did you mean 'joint" in said


FORMS = {
    ("euler", "ZYZ"): lambda R: R.as_euler("ZYZ", degrees=True),
    ("euler", "xzy"): lambda R: R.as_euler("xzy", degrees=True),
    ("rotation vector", ""): lambda R: np.degrees(R.as_rotvec()),
    ("quaternion", "wxyz"): lambda R: -R.as_quat(scalar_first=True),  # either sign is the same rotation
    ("quaternion", "xyzw"): lambda R: R.as_quat(),
    ("matrix", ""): lambda R: R.as_matrix().reshape(-1, 9),
}
POSED = Rotation.from_euler("XYZ", rows(5)[:, 6:9], degrees=True)


def series_in_form(folder, form, columns):
    """Read the series of a table whose rotations have this form, with its order, and these columns."""
    heads = tuple(f"r{k}" for k in range(columns.shape[1]))
    table = {"columns": list(heads), "unit": "deg" if columns.shape[1] == 3 else ""}
    table |= dict(zip(("form", "order"), form, strict=True))
    old = MAPPING[MAPPING.index("[rotation]") : MAPPING.index("\n[air]")]
    mapping = MAPPING.replace(old, toml_text({"rotation": table}))
    numbers = rows(5)
    poses = text(np.column_stack([numbers[:, :6], columns, numbers[:, -1]]), heads)
    named = read_mapping(written(folder, "m.toml", mapping))
    return series_from_table(written(folder, "poses.csv", poses), named)


@pytest.mark.parametrize("form", FORMS)
def test_a_rotation_is_the_same_in_every_form(tmp_path, form):
    read = series_in_form(tmp_path, form, FORMS[form](POSED))
    np.testing.assert_allclose(np.moveaxis(read.X_TM.R, -1, 0), POSED.as_matrix(), atol=1e-8)


QUATERNION, MATRIX = ("quaternion", "wxyz"), ("matrix", "")


@pytest.mark.parametrize("form", [QUATERNION, MATRIX])
def test_numbers_rounded_to_two_decimals_are_a_rotation(tmp_path, form):
    read = series_in_form(tmp_path, form, np.round(FORMS[form](POSED), 2))
    np.testing.assert_allclose(np.moveaxis(read.X_TM.R, -1, 0), POSED.as_matrix(), atol=0.05)


@pytest.mark.parametrize(
    ("form", "factor"), [(QUATERNION, 0.0), (QUATERNION, 1.02), (MATRIX, -1.0), (MATRIX, 1.02)]
)
def test_numbers_that_are_no_rotation_are_named_by_their_row(tmp_path, form, factor):
    columns = FORMS[form](POSED)
    columns[2] *= factor
    with pytest.raises(RobotError, match=r"poses.csv: row 3, columns r0, .*: are no rotation as a "):
        series_in_form(tmp_path, form, columns)
