"""The mapping of docs/logs.md, applied to the measurements that it describes."""

import re
from pathlib import Path

import numpy as np
import pytest

from marsarm.telemetry.imports.files import BadImport
from marsarm.telemetry.imports.job import ImportRequest, convert_table, import_table
from marsarm.telemetry.read import Log, read_log

DOC = Path(__file__).parents[4] / "docs" / "logs.md"
ROWS = 11_911


def mapping() -> str:
    """Return the example of the page for these data."""
    examples = re.findall(r"```toml\n(.*?)```", DOC.read_text(), re.DOTALL)
    return next(text for text in examples if "UR10" in text)


@pytest.mark.real_data
def test_the_tracker_s_table_becomes_a_log(real_data: Path, tmp_path: Path) -> None:
    (tmp_path / "ur10.toml").write_text(mapping())
    table = real_data / "ur10-tracker" / "series_a_grid.csv"
    report = import_table(
        ImportRequest(table, tmp_path / "ur10.toml", tmp_path / "ur10.mcap"), lambda *_: None
    )
    assert (report.rows, report.replayable) == (ROWS, False)
    assert report.rows_moved > 0
    log = read_log(tmp_path / "ur10.mcap")
    assert len(log["/imported/ur10"]) == len(log["/imported/tracker"]) == ROWS
    check_first_row(log)


def check_first_row(log: Log) -> None:
    """Check the numbers of the first line, converted by hand."""
    tracker, arm = log["/imported/tracker"][0], log["/imported/ur10"][0]
    assert tracker["target_m"] == pytest.approx([2.3619831, -1.3685474, 0.11939713])
    assert np.degrees(tracker["target_rad"]) == pytest.approx([-90.409151, -59.885105, -90.887438])
    assert arm["motor_rad"] == pytest.approx([-1.5708, -1.5708, 0.0, -1.5708, 0.0, 0.0])
    assert arm["air_C"] == pytest.approx(23.6800003051758)


@pytest.mark.real_data
def test_times_that_a_spreadsheet_has_rounded_are_refused(real_data: Path) -> None:
    table = real_data / "ur10-tracker" / "series_c_random_poses.csv"
    with pytest.raises(BadImport, match=r"row 1, column 'Timestamp': '2,02011E\+13' is no time"):
        convert_table(table.read_bytes(), str(table), mapping().encode(), "ur10.toml")
