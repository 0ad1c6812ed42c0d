"""The page of the robot file: a line for each key, as the code describes it."""

import pytest

from helpers.real_robots import repository_file
from simgap.common.toml import Record
from simgap.files.robot_file import (
    CsvTable,
    JointTable,
    MotionTable,
    RobotFile,
    SerialFile,
    SignalColumn,
    TimeTable,
)
from simgap.loading import SplitFile, SplitTable

TABLES = {
    "Robot": RobotFile,
    "`[time]`": TimeTable,
    "`[motion]`": MotionTable,
    "`[csv]`": CsvTable,
    "`[joints.NAME]`": JointTable,
    "Columns": SignalColumn,
    "Split file": SplitFile,
    "`[splits.NAME]`": SplitTable,
    "Arm with tracker poses": SerialFile,
}


def lines_of(record: type[Record]) -> list[str]:
    """Return the lines of the list of a record: key, default, meaning."""
    lines = []
    for key, field in record.model_fields.items():
        default = field.get_default(call_default_factory=True)
        is_plain = isinstance(default, (str, float, int)) and default != ""
        shown = " (needed)" if field.is_required() else f" (`{str(default).lower()}`)" if is_plain else ""
        lines.append(f"- `{key}`{shown}: {' '.join(str(field.description).split())}")
    return lines


@pytest.mark.parametrize("heading", TABLES)
def test_the_page_has_a_line_for_each_key(heading: str) -> None:
    section = repository_file("docs/robot-file.md").read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    shown = [line for line in section.splitlines() if line.startswith("- `")]
    assert shown == lines_of(TABLES[heading])
