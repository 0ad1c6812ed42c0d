"""Turret poses measured by a laser tracker: a CSV table by tick, beside a log."""

import csv
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsw.kinematics.transforms import Array, Pose
from simgap.common.errors import RobotError
from simgap.common.toml import decode_text

POSE_COLUMNS: Final = ("tick", "rx_rad", "ry_rad", "rz_rad", "x_m", "y_m", "z_m")
SIGMA_COLUMNS: Final = ("rx_sigma_rad", "ry_sigma_rad", "rz_sigma_rad", "x_sigma_m", "y_sigma_m", "z_sigma_m")


class BadTracker(ValueError):
    """Table that does not hold tracker poses; the message says where and why."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackerPoses:
    """Poses of the turret interface in RMECH, n of them, in the order of ticks."""

    tick: NDArray[np.int64]
    X_RF: Pose
    sigma: Array
    """Standard deviation of the screw from true to measured, turret axes, rotation first, shape (6, n)."""


def no_tracker_poses() -> TrackerPoses:
    """Return an empty table."""
    return TrackerPoses(np.zeros(0, np.int64), Pose(np.zeros((3, 3, 0)), np.zeros((3, 0))), np.zeros((6, 0)))


def write_tracker_poses(path: Path, seen: TrackerPoses) -> None:
    """Write a CSV file: rotation vector, position, and standard deviations."""
    turn = Rotation.from_matrix(np.moveaxis(seen.X_RF.R, -1, 0)).as_rotvec() if seen.tick.size else []
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow((*POSE_COLUMNS, *SIGMA_COLUMNS))
        for k, tick in enumerate(seen.tick):
            numbers = (*turn[k], *seen.X_RF.p[:, k], *seen.sigma[:, k])
            table.writerow((int(tick), *(repr(float(number)) for number in numbers)))


def read_tracker_poses(path: Path) -> TrackerPoses:
    """Read a CSV file.

    Raises:
        BadTracker: It cannot be read, a column is missing, or a value is wrong or repeated.
    """
    try:
        table = csv.DictReader(StringIO(decode_text(path.read_bytes(), str(path)), newline=""))
        rows, missing = list(table), {*POSE_COLUMNS, *SIGMA_COLUMNS} - set(table.fieldnames or ())
    except OSError as error:
        raise BadTracker(f"{path}: cannot be read ({error.strerror or error})") from error
    except RobotError as error:
        raise BadTracker(str(error)) from error
    except csv.Error as error:
        raise BadTracker(f"{path}: is not a table in CSV; it is damaged or of another format") from error
    if missing:
        raise BadTracker(f"{path}: has no column {', '.join(sorted(missing))}")
    if not rows:
        return no_tracker_poses()
    try:
        numbers = np.array([[float(row[name]) for name in (*POSE_COLUMNS, *SIGMA_COLUMNS)] for row in rows]).T
    except (TypeError, ValueError) as error:
        raise BadTracker(f"{path}: something in it is no number") from error
    if not np.isfinite(numbers).all() or (numbers[7:] <= 0).any():
        raise BadTracker(f"{path}: every number must be finite, and every sigma above 0")
    tick = numbers[0].astype(np.int64)
    if np.any(tick != numbers[0]) or np.unique(tick).size != tick.size:
        raise BadTracker(f"{path}: ticks must be whole numbers, each there once")
    R = np.moveaxis(Rotation.from_rotvec(numbers[1:4].T).as_matrix(), 0, -1)
    return TrackerPoses(tick, Pose(R, numbers[4:7]), numbers[7:])
