"""Lists of what is in a log: names, kinds, counts, rates and ranges."""

import json

import numpy as np
import pytest

from helpers.robot_folder import write_csv, write_lerobot, write_npz, write_parquet
from simgap.common.errors import RobotError
from simgap.files.columns import ColumnInfo
from simgap.files.log_file import list_columns, open_log
from simgap.files.robot_file import CsvTable


@pytest.mark.parametrize("write", [write_parquet, write_csv, write_npz])
def test_the_columns_of_a_table_are_listed(tmp_path, write):
    found = {one.name: one for one in list_columns(write(tmp_path))}
    assert list(found) == ["t", "motion", "gain", "q1", "c1", "q2", "m2"]
    assert found["q1"] == ColumnInfo("q1", "number", 7, None, 0.0, 180.0)
    assert found["motion"] == ColumnInfo("motion", "text", 7)


def test_items_of_lists_and_fields_of_records_are_columns(tmp_path):
    np.savez(tmp_path / "log.npz", q=np.arange(6.0).reshape(3, 2), rate=50.0)
    assert [one.name for one in list_columns(tmp_path / "log.npz")] == ["q[0]", "q[1]"]
    rows = [{"t": k, "arm": {"q": [k, 2.0 * k], "mode": "on"}} for k in range(3)]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, rows)))
    found = list_columns(tmp_path / "log.jsonl")
    assert [one.name for one in found] == ["t", "arm.q[0]", "arm.q[1]", "arm.mode"]
    assert (found[2].lowest, found[2].highest) == (0.0, 4.0)


def test_fields_may_have_any_names_and_empty_arrays_are_passed_over(tmp_path):
    (tmp_path / "log.jsonl").write_text('{"arm": {"joint 1": 2.0, "x-y": 3.0, "Öl": 4.0}}\n')
    assert [one.lowest for one in list_columns(tmp_path / "log.jsonl")] == [2.0, 3.0, 4.0]
    log = open_log(tmp_path / "log.jsonl", ["arm.x-y"], [], CsvTable())
    assert log.numbers("arm.x-y").value == [3.0]
    np.savez(tmp_path / "log.npz", t=np.arange(3.0), contacts=np.zeros((3, 0)))
    assert [one.name for one in list_columns(tmp_path / "log.npz")] == ["t"]


def test_a_list_has_the_names_of_the_information_file(tmp_path):
    folder = write_lerobot(tmp_path / "set", ("pan.pos", "lift.pos"), [(np.ones((2, 2)),) * 2] * 2, 10.0)
    for log in (folder, folder / "data" / "chunk-000" / "episode_000000.parquet"):
        names = [one.name for one in list_columns(log)]
        assert names[:3] == ["action[pan.pos]", "action[lift.pos]", "observation.state[pan.pos]"]
        assert names[4:] == ["timestamp", "episode_index"]
    assert list_columns(folder)[0].rate_Hz == pytest.approx(10.0)
    assert list_columns(folder)[4].unit == "s"


def test_a_log_without_columns_is_refused(tmp_path):
    np.savez(tmp_path / "log.npz", rate=50.0)
    with pytest.raises(RobotError, match="has no rows; name a log with samples"):
        list_columns(tmp_path / "log.npz")
