"""Convert the published logs of the SO-101 to the Parquet file that its robot file reads.

Upstream has a folder a motion: control.csv with the commands and state_motor.csv with the measured state, a
row each for the same time stamp, in microseconds. Motions that the split file does not name are left out.
"""

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.loading import read_split
from simgap.robot import Robot

EXAMPLE: Final = "example: python -m validation.so101_logs sage/output/real/so101/custom so101.parquet"
ROBOT: Final = Path(__file__).parents[1] / "models" / "robots" / "so101" / "robot.toml"


def convert(folder: Path, joints: tuple[str, ...], motions: list[str]) -> pa.Table:
    """Read the motions in the order of their names.

    Args:
        folder: Folder with a folder for each motion.
        joints: Names of the joints, in the order of the logs.
        motions: Names of the motions.

    Raises:
        RobotError: A file is missing, or the rows of a motion do not agree.
    """
    tables = []
    for name in sorted(motions):
        (time_s, command), (_, position, velocity) = (
            _read(folder / name / "control.csv", len(joints), ["positions"]),
            _read(folder / name / "state_motor.csv", len(joints), ["positions", "velocities"]),
        )
        if len(command) != len(position):
            raise RobotError(f"{folder / name}: has {len(command)} commands and {len(position)} states")
        columns: dict[str, pa.Array] = {"log": pa.array([name] * len(command)), "t_s": pa.array(time_s[:, 0])}
        for what, values in {"command": command, "position": position, "velocity": velocity}.items():
            columns |= {f"{what}_{one}": pa.array(values[:, j]) for j, one in enumerate(joints)}
        tables.append(pa.table(columns))
    return pa.concat_tables(tables)


def _read(path: Path, n_joints: int, names: list[str]) -> tuple[Array, ...]:
    """Return the times (n, 1) [s] and the lists of each row, (n, n_joints) a column."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        time_s = np.array([[1e-6 * float(row["timestamp"])] for row in rows])
        lists = (np.array([json.loads(row[name]) for row in rows], dtype=float) for name in names)
        found = (time_s, *(one.reshape(len(rows), n_joints) for one in lists))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RobotError(
            f"{path}: is no log of the SO-101 ({error}); name the folder with its motions"
        ) from error
    return found


def main() -> int:
    """Convert the logs."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.so101_logs",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="folder with a folder for each motion")
    parser.add_argument("out", type=Path, help="Parquet file to write")
    options = parser.parse_args()
    joints = tuple(one.name for one in Robot.from_toml(ROBOT).joints)
    motions = [one for part in read_split(ROBOT.parent / "split.toml").parts.values() for one in part]
    try:
        table = convert(options.folder, joints, motions)
    except RobotError as error:
        print(error, file=sys.stderr)
        return 2
    pq.write_table(table, options.out)
    print(f"{options.out}: {len(motions)} motions, {table.num_rows} rows")
    return 0


if __name__ == "__main__":
    sys.exit(main())
