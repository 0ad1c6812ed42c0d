"""Published logs of an SO-101, as its robot file reads them (docs/results.md).

Upstream has a folder a motion: control.csv with the commands and state_motor.csv with the measured state, a
row each for the same time stamp, in microseconds. All motions are converted; those that the split file does
not name take no part.
"""

import csv
import json
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.robot import Robot
from validation.campaigns import Context, Document

ROBOT: Final = Path(__file__).parents[1] / "models" / "robots" / "so101" / "robot.toml"
FILES: Final = ("control.csv", "state_motor.csv")


def convert(folder: Path, joints: tuple[str, ...]) -> pa.Table:
    """Read all motions of a folder, in the order of their names, by the names of the joints in the logs.

    RobotError if there is none, a file is missing, or the rows of a motion do not agree.
    """
    tables = []
    names = sorted({one.parent.name for file in FILES for one in folder.glob(f"*/{file}")})
    if not names:
        files = " and ".join(FILES)
        raise RobotError(f"{folder}: has no folder of a motion, with {files}; name the folder above")
    for name in names:
        (time_s, command), (_, position, velocity) = (
            _read(folder / name / FILES[0], len(joints), ["positions"]),
            _read(folder / name / FILES[1], len(joints), ["positions", "velocities"]),
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


def campaign(context: Context, logs: Path) -> Document:
    """Convert the published logs, a folder with a folder a motion, to a file in the folder of results."""
    joints = tuple(one.name for one in Robot.from_toml(ROBOT).joints)
    path = (context.out or Path()) / "so101.parquet"
    pq.write_table(convert(logs, joints), path)
    return {"logs": str(path), "in_bounds": True}
