"""Logs that are tables: data sets of LeRobot, lists, JSON lines, CSV as it comes, and lists of columns."""

import gzip
import json

import numpy as np
import pytest

from helpers.robot_folder import COLUMNS, write_csv, write_lerobot, write_npz, write_parquet, write_robot
from simgap.common.errors import RobotError
from simgap.files.columns import ColumnInfo
from simgap.files.log_file import open_log, open_whole
from simgap.files.robot_file import CsvTable
from simgap.loading import load

STATE = "observation.state"
BY_LIST = (
    ('[time]\ncolumn = "t"\nunit = "ms"', ""),
    ('[motion]\ncolumns = ["motion"]\n\n[conditions.gain]\ncolumn = "gain"', ""),
    ('gain_column = "gain"\n', ""),
    ('"q1", unit = "deg", factor = -1.0, zero_rad = 0.5', '"observation.state[0]", unit = "deg"'),
    ('"c1", unit = "deg"', '"action[shoulder.pos]", unit = "percent", at_0_rad = -1.0, at_1_rad = 3.0'),
    ('"q2", unit = "count", counts_per_turn = 4096.0, side = "motor"', f'"{STATE}[elbow.pos]", unit = "deg"'),
    ('torque = { column = "m2", unit = "mN m", side = "motor" }\n', ""),
)
N = 4


def opened(path, text, *names):
    """Write a file of text; return it with these columns."""
    path.write_text(text)
    return open_log(path, names, [], CsvTable())


def write_set(folder, names=("shoulder.pos", "elbow.pos"), **info):
    """Write a data set of two episodes."""
    action = [[25.0 * k, 0.0] for k in range(N)]
    episodes = [(action, [[10.0 * one + k, -float(k)] for k in range(N)]) for one in range(2)]
    return write_lerobot(folder, names, episodes, **info)


def test_episodes_of_a_data_set_are_motions_with_times_of_their_own(tmp_path):
    first, second = load(write_robot(tmp_path, *BY_LIST), write_set(tmp_path / "set")).motions
    assert (first.name, second.name) == ("0", "1")
    shoulder = second.joints["shoulder"]
    np.testing.assert_allclose(shoulder.position.time_s, 0.02 * np.arange(N), atol=1e-7)
    np.testing.assert_allclose(shoulder.position.value, np.radians(10.0 + np.arange(N)))
    np.testing.assert_allclose(shoulder.command.value, [-1.0, 0.0, 1.0, 2.0])
    np.testing.assert_allclose(second.joints["elbow"].position.value, np.radians(-np.arange(N)))


def test_a_data_file_that_is_missing_is_told(tmp_path):
    logs = load(write_robot(tmp_path, *BY_LIST), write_set(tmp_path / "set", total_frames=99))
    assert "has 8 rows, its meta/info.json says 99: data files are missing" in logs.losses[0]


def test_a_name_that_no_list_has_is_refused_with_those_that_it_has(tmp_path):
    folder = write_set(tmp_path / "set", names=("a.pos", "b.pos"))
    with pytest.raises(RobotError, match=r"has no column 'action\[shoulder.pos\]'.* did you mean|it has"):
        load(write_robot(tmp_path, *BY_LIST), folder)


@pytest.mark.parametrize("text", ["{", "[]", ""])
def test_a_damaged_information_file_is_refused(tmp_path, text):
    folder = write_set(tmp_path / "set")
    (folder / "meta" / "info.json").write_text(text)
    with pytest.raises(RobotError, match=r"info\.json: "):
        load(write_robot(tmp_path, *BY_LIST), folder)


def test_arrays_of_several_dimensions_are_read_by_place(tmp_path):
    both = np.stack([COLUMNS["q1"], COLUMNS["c1"]], axis=1)
    change = [('column = "q1"', 'column = "both[0]"'), ('column = "c1"', 'column = "both[1]"')]
    slow, _ = load(write_robot(tmp_path, *change), write_npz(tmp_path, both=both)).motions
    np.testing.assert_allclose(slow.joints["shoulder"].command.value, np.radians([0.0, 9.0, 18.0]))
    with pytest.raises(
        RobotError, match=r"no column 'both\[5\]', which robot file or mapping names; did you mean"
    ):
        open_log(tmp_path / "log.npz", ["both[5]"], [], CsvTable())


def test_json_lines_have_objects_and_lists(tmp_path):
    rows = [{"t": 1.0 * k, "arm": {"q": [k, None if k == 1 else 2 * k]}} for k in range(3)]
    path = tmp_path / "log.jsonl"
    log = opened(path, "\n".join(map(json.dumps, rows)) + '\n{"t": 3.0, "ar', "t", "arm.q[1]")
    np.testing.assert_array_equal(log.numbers("t").value, [0.0, 1.0, 2.0])
    assert log.numbers("arm.q[1]").is_present.tolist() == [True, False, True]
    assert log.losses == ["line 4 is cut, where the file ends; the 3 lines before it are used"]
    with pytest.raises(RobotError, match="line 2 is no JSON"):
        opened(path, "{}\nno\n{}", "t")


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", ","), (";", "."), ("\t", "."), ("|", "."), ("   ", ".")]
)
def test_the_form_of_a_csv_is_found_by_itself_and_may_be_told(tmp_path, separator, decimal):
    write_csv(tmp_path, separator, decimal)
    told = f"[csv]\nseparator = '{separator[0]}'\ndecimal = '{decimal}'\n\n[time]\ncolumn"
    for changes in ([], [("[time]\ncolumn", told)]):
        slow, fast = load(write_robot(tmp_path, *changes), tmp_path / "log.csv").motions
        np.testing.assert_allclose(slow.joints["shoulder"].command.value, np.radians([0.0, 9.0, 18.0]))
        assert fast.name == "fast"


@pytest.mark.parametrize("head", ["", "0,1\n"])
def test_a_csv_without_names_has_its_columns_by_place(tmp_path, head):
    name = "1" if head else "column[1]"
    log = opened(tmp_path / "log.csv", head + "0.0,1.5\n0.1,2.5\n", name)
    np.testing.assert_array_equal(log.numbers(name).value, [1.5, 2.5])


def test_the_last_row_of_a_csv_may_be_cut(tmp_path):
    log = opened(tmp_path / "log.csv", "t,a,b\n0,1,2\n1,2,3\n2,5", "b")
    np.testing.assert_array_equal(log.numbers("b").value, [2.0, 3.0])
    assert log.losses == ["line 4 has 2 of 3 columns, where the file was cut; the 2 rows before it are used"]
    with pytest.raises(RobotError, match="line 2 has 2 of 3 columns; give each row all columns"):
        opened(tmp_path / "log.csv", "t,a,b\n0,1\n1,2,3\n", "b")


def test_all_rows_of_a_csv_decide_its_types(tmp_path):
    text = "t,a\n" + "".join(f"{k},0\n" for k in range(300_000)) + "300000,0.5\n"
    assert opened(tmp_path / "log.csv", text, "a").numbers("a").value[-1] == 0.5


@pytest.mark.parametrize(
    ("head", "n_left_out"),
    [
        ("t,q\n", 0),
        ("# t,q\n", 0),  # numpy.savetxt
        ("run 3 of Monday\nt,q\n", 1),
        ("Monday;arm A,\nt,q\n", 1),
        ("t,q\ns,rad\n", 1),
        ("# robot A\n# t,q\n", 1),
        ("# robot A, Monday, 3\nt,q\n", 1),
    ],
)
def test_lines_without_numbers_before_the_rows_are_header_or_left_out(tmp_path, head, n_left_out):
    log = opened(tmp_path / "log.csv", head + "0.0,1.5\n0.1,2.5\n0.2,3.5\n0.3,4.5\n0.4", "t", "q")
    np.testing.assert_array_equal(log.numbers("q").value, [1.5, 2.5, 3.5, 4.5])
    n_lines = head.count("\n") + 5
    cut = f"line {n_lines} has 1 of 2 columns, where the file was cut; the 4 rows before it are used"
    left_out = "1 line without numbers before the rows of numbers is left out"
    assert log.losses == [left_out] * n_left_out + [cut]


def test_numpy_and_fortran_separate_columns_by_spaces(tmp_path):
    path = tmp_path / "log.txt"
    np.savetxt(path, np.arange(8.0).reshape(4, 2), header="t q")
    assert open_log(path, ["q"], [], CsvTable()).numbers("q").value.tolist() == [1.0, 3.0, 5.0, 7.0]
    np.savetxt(path, np.arange(8.0).reshape(4, 2), header="made on Monday")
    assert [one.name for one in open_whole(path).describe()] == ["column[0]", "column[1]"]


def test_columns_without_a_name_have_their_place_and_names_given_twice_are_told(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(",t,q,q,\n0,0.0,1,2,7\n1,0.1,3,4,8\n")
    log = open_whole(path)
    assert [one.name for one in log.describe()] == ["column[0]", "t", "q", "column[4]"]
    assert log.losses == ["has 2 columns 'q'; give each its own name"]
    assert open_log(path, ["column[4]"], [], CsvTable()).numbers("column[4]").value.tolist() == [7.0, 8.0]
    with pytest.raises(RobotError, match="has 2 columns 'q'; give each its own name"):
        open_log(path, ["q"], [], CsvTable())


def test_nan_in_a_csv_is_an_empty_cell_and_a_word_is_none(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,q,name\n0,1,nan\n1,NaN,b\n2,nan,c\n3,,d\n4,5,e\n")
    column = open_log(path, ["q"], ["name"], CsvTable())
    assert column.numbers("q").is_present.tolist() == [True, False, False, False, True]
    assert column.texts("name").tolist() == ["nan", "b", "c", "d", "e"]


@pytest.mark.parametrize("times", ["9:30:00.5,9:30:01,10:00:00", "09:30:00,09:30:01,10:00:00"])
def test_times_of_day_are_seconds(tmp_path, times):
    text = "t,q\n" + "".join(f"{time},1\n" for time in times.split(","))
    found = opened(tmp_path / "log.csv", text, "t").numbers("t").value
    assert found.tolist() == [34200.5 if "." in times else 34200.0, 34201.0, 36000.0]


def test_text_is_read_as_it_is_packed(tmp_path):
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"t,q\n0,1\n1,2\n"))
    assert open_log(path, ["q"], [], CsvTable()).numbers("q").value.tolist() == [1.0, 2.0]
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(RobotError, match="cannot be read"):
        open_log(path, ["q"], [], CsvTable())
    path.rename(tmp_path / "log.parquet.gz")
    with pytest.raises(RobotError, match="is packed; unpack it with gunzip"):
        open_log(tmp_path / "log.parquet.gz", ["q"], [], CsvTable())


def test_an_array_with_a_row_a_joint_is_transposed_and_told(tmp_path):
    q = np.arange(12.0).reshape(2, 6)
    np.savez(tmp_path / "log.npz", t=np.arange(6.0), q=q, v=q.T, square=np.zeros((6, 6)))
    log = open_whole(tmp_path / "log.npz")
    names = [one.name for one in log.describe()]
    assert names == ["t", "q[0]", "q[1]", "v[0]", "v[1]", *(f"square[{k}]" for k in range(6))]
    assert log.losses == ["'q' has 2 rows of 6 values: it is transposed, to have a row a sample"]
    read = open_log(tmp_path / "log.npz", ["t", "q[1]", "v[1]"], [], CsvTable())
    np.testing.assert_array_equal(read.numbers("q[1]").value, read.numbers("v[1]").value)


@pytest.mark.parametrize("write", [write_parquet, write_csv, write_npz])
def test_the_columns_of_a_table_are_listed(tmp_path, write):
    found = {one.name: one for one in open_whole(write(tmp_path)).describe()}
    assert list(found) == ["t", "motion", "gain", "q1", "c1", "q2", "m2"]
    assert found["q1"] == ColumnInfo("q1", "number", 7, None, 0.0, 180.0)
    assert found["motion"] == ColumnInfo("motion", "text", 7)


def test_items_of_lists_and_fields_of_records_are_columns(tmp_path):
    np.savez(tmp_path / "log.npz", q=np.arange(6.0).reshape(3, 2), rate=50.0)
    assert [one.name for one in open_whole(tmp_path / "log.npz").describe()] == ["q[0]", "q[1]"]
    rows = [{"t": k, "arm": {"q": [k, 2.0 * k], "mode": "on"}} for k in range(3)]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, rows)))
    found = open_whole(tmp_path / "log.jsonl").describe()
    assert [one.name for one in found] == ["t", "arm.q[0]", "arm.q[1]", "arm.mode"]
    assert (found[2].lowest, found[2].highest) == (0.0, 4.0)


def test_fields_may_have_any_names_and_empty_arrays_are_passed_over(tmp_path):
    (tmp_path / "log.jsonl").write_text('{"arm": {"joint 1": 2.0, "x-y": 3.0, "Öl": 4.0}}\n')
    assert [one.lowest for one in open_whole(tmp_path / "log.jsonl").describe()] == [2.0, 3.0, 4.0]
    log = open_log(tmp_path / "log.jsonl", ["arm.x-y"], [], CsvTable())
    assert log.numbers("arm.x-y").value == [3.0]
    np.savez(tmp_path / "log.npz", t=np.arange(3.0), contacts=np.zeros((3, 0)))
    assert [one.name for one in open_whole(tmp_path / "log.npz").describe()] == ["t"]


def test_a_list_has_the_names_of_the_information_file(tmp_path):
    folder = write_lerobot(tmp_path / "set", ("pan.pos", "lift.pos"), [(np.ones((2, 2)),) * 2] * 2, 10.0)
    for log in (folder, folder / "data" / "chunk-000" / "episode_000000.parquet"):
        names = [one.name for one in open_whole(log).describe()]
        assert names[:3] == ["action[pan.pos]", "action[lift.pos]", "observation.state[pan.pos]"]
        assert names[4:] == ["timestamp", "episode_index"]
    assert open_whole(folder).describe()[0].rate_Hz == pytest.approx(10.0)
    assert open_whole(folder).describe()[4].unit == "s"


def test_a_log_without_columns_is_refused(tmp_path):
    np.savez(tmp_path / "log.npz", rate=50.0)
    with pytest.raises(RobotError, match="has no rows; name a log with samples"):
        open_whole(tmp_path / "log.npz").describe()
