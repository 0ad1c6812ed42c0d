"""Data of a calibration campaign: poses at rest, as believed by flight software and as measured.

Poses are selected by flags, (n,), or by indices in the wanted order, (k,).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv, parquet
from scipy.spatial.transform import Rotation

from fsw.dictionary.enums import Joint
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.transforms import Array, Flags, Integers, Pose, select_targets
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write
from simgap.files.log_file import open_whole


class BadData(BadRequest):
    """Error: data or a fit that are not acceptable, with one line for each reason."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoses:
    """Measured poses with their covariances."""

    X_RT: Pose
    """Turret frame in the rover frame, batch (n,)."""
    covariance: Array
    """Covariance of the screw from true to measured pose, in its axes, rotation first, shape (n, 6, 6)."""


@dataclass(frozen=True, slots=True, eq=False)
class BelievedPoses:
    """State of the arm at each pose as flight software knows it; joint arrays have shape (5, n)."""

    motor_rad: Array
    """Motor angles on the output side."""
    backlash_rad: Array
    """Positions of the outputs in their backlash; half the width at a flank."""
    friction_Nm: Array
    """Load that friction of the outputs carries, so that the gears do not carry it."""
    side: Array
    """+1 or -1 if the output certainly lies on that side of the backlash, 0 if it is uncertain."""
    gravity_R_m_s2: Array
    """Gravity in the rover frame, shape (3, n)."""
    turret_kg: Array
    """Mass of the stand-in turret, shape (n,); NaN for the arm's own turret."""

    def at(self, poses: Flags | Integers) -> "BelievedPoses":
        """Select some of the poses."""
        return select_targets(self, poses)


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Poses of one campaign in the order of measurement."""

    arm_name: str
    group: Integers
    """Index of the group of each pose, shape (n,)."""
    branch: tuple[str, ...]
    """Name of the inverse-kinematics branch of each pose."""
    believed: BelievedPoses
    measured: MeasuredPoses
    targets_seen: Integers
    """Number of targets on ground, rover and turret that the tracker saw, shape (3, n)."""
    misfit_m: Array
    """Root mean square distance of targets from a rigid body, shape (n,)."""
    tracker_moved_m: Array
    """Apparent motion of the ground targets since the first pose, shape (n,)."""

    @property
    def count(self) -> int:
        """Return the number of poses."""
        return self.group.size

    def at(self, poses: Flags | Integers) -> "Campaign":
        """Select some of the poses."""
        where = np.flatnonzero(poses) if poses.dtype == bool else poses
        return Campaign(
            self.arm_name,
            self.group[where],
            tuple(self.branch[int(k)] for k in where),
            self.believed.at(where),
            MeasuredPoses(self.measured.X_RT[where], self.measured.covariance[where]),
            self.targets_seen[:, where],
            self.misfit_m[where],
            self.tracker_moved_m[where],
        )


JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
COVARIANCE_INDICES: Final = tuple((i, j) for i in range(6) for j in range(i, 6))
TEXT_COLUMNS: Final = ("arm", "branch")
COUNT_COLUMNS: Final = ("group", "targets_ground", "targets_rover", "targets_turret")
QUANTITIES: Final = (
    tuple(f"motor_{joint}_rad" for joint in JOINT_NAMES),
    tuple(f"backlash_{joint}_rad" for joint in JOINT_NAMES),
    tuple(f"friction_{joint}_Nm" for joint in JOINT_NAMES),
    tuple(f"side_{joint}" for joint in JOINT_NAMES),
    tuple(f"gravity_{axis}_m_s2" for axis in "xyz"),
    ("turret_kg",),
    tuple(f"p_{axis}_m" for axis in "xyz"),
    tuple(f"q_{part}" for part in "wxyz"),
    tuple(f"cov_{i}{j}" for i, j in COVARIANCE_INDICES),
    ("misfit_m",),
    ("tracker_moved_m",),
)
NUMBER_COLUMNS: Final = tuple(chain(*QUANTITIES))
MAY_BE_EMPTY: Final = ("turret_kg",)
NORM_TOLERANCE: Final = 1e-3
"""Largest difference of the norm of a quaternion from 1."""
MOST_ROWS: Final = 100_000


def save_campaign(campaign: Campaign, path: Path) -> None:
    """Write the table as .parquet or .csv, by its suffix; BadOutput if the file cannot be written."""
    table = pa.table(dict(_columns(campaign)))
    with atomic_write(path, "data") as file:
        if path.suffix.lower() == ".csv":
            csv.write_csv(table, file)
        else:
            parquet.write_table(table, file)


def read_campaign(path: Path) -> Campaign:
    """Read a table; BadData if the file cannot be read or is too large, or columns or values are wrong."""
    try:
        log = open_whole(path)
        there = {one.name for one in log.describe()}
    except RobotError as error:
        raise BadData(str(error)) from error
    missing = [n for n in (*TEXT_COLUMNS, *COUNT_COLUMNS, *NUMBER_COLUMNS) if n not in there]
    if missing:
        raise BadData(f"{path}: columns missing: {', '.join(missing)}; docs/calibration.md lists them all")
    column: dict[str, Any] = {name: log.texts(name) for name in TEXT_COLUMNS}
    problems = [f"{path}: {problem}" for problem in _text_problems(column)]
    for name in (*COUNT_COLUMNS, *NUMBER_COLUMNS):
        try:
            column[name] = log.numbers(name).value
        except RobotError as error:
            problems.append(str(error))
            continue
        bad = ~np.isfinite(column[name])
        if name not in MAY_BE_EMPTY and bad.any():
            problems.append(
                f"{path}: column {name}: no number in {int(bad.sum())} rows, the first is "
                f"{int(np.argmax(bad))}; leave such poses out"
            )
    if problems:
        raise BadData("\n".join(problems))
    return _campaign(column)


def _columns(campaign: Campaign) -> Iterator[tuple[str, Any]]:
    b, X = campaign.believed, campaign.measured.X_RT
    yield "arm", [campaign.arm_name] * campaign.count
    yield "branch", list(campaign.branch)
    yield "group", campaign.group
    yield from zip(COUNT_COLUMNS[1:], campaign.targets_seen, strict=True)
    of_joints = np.concatenate([b.motor_rad, b.backlash_rad, b.friction_Nm, b.side, b.gravity_R_m_s2])
    quat = Rotation.from_matrix(np.moveaxis(X.R, -1, 0)).as_quat(canonical=True, scalar_first=True).T
    cov = np.array([campaign.measured.covariance[:, i, j] for i, j in COVARIANCE_INDICES])
    last = np.stack([campaign.misfit_m, campaign.tracker_moved_m])
    rows = np.concatenate([of_joints, b.turret_kg[None], X.p, quat, cov, last])
    for name, row in zip(NUMBER_COLUMNS, rows, strict=True):
        yield name, pa.array(row, from_pandas=name in MAY_BE_EMPTY)


def _text_problems(column: Mapping[str, NDArray[np.str_]]) -> Iterator[str]:
    if column["arm"].size > MOST_ROWS:
        yield f"{column['arm'].size} rows; {MOST_ROWS} poses are the most"
    if set(column["branch"].tolist()) - set(BRANCHES):
        yield f"column branch: only {', '.join(BRANCHES)}"
    if len(set(column["arm"].tolist())) > 1:
        yield "column arm: poses of several arms; calibrate one at a time"
    if not all(column["arm"].tolist()):
        yield "column arm: is empty; give the arm's name in every row"


def _campaign(column: dict[str, Array]) -> Campaign:
    numbers = np.array([column[name] for name in NUMBER_COLUMNS], float)
    parts = np.split(numbers, np.cumsum([len(one) for one in QUANTITIES])[:-1])
    motor, backlash, friction, side, gravity, turret_kg, p, quat, upper, misfit_m, moved_m = parts
    length = np.linalg.norm(quat, axis=0)
    if np.any(np.abs(length - 1) > NORM_TOLERANCE):
        row = int(np.argmax(np.abs(length - 1)))
        raise BadData(f"columns q_*: row {row} has length {length[row]:.4g}; a quaternion w, x, y, z has 1")
    covariance = np.zeros((quat.shape[1], 6, 6))
    for (i, j), values in zip(COVARIANCE_INDICES, upper, strict=True):
        covariance[:, i, j] = covariance[:, j, i] = values
    lowest = np.linalg.eigvalsh(covariance)[:, 0] if covariance.size else np.ones(0)
    if np.any(lowest <= 0):
        raise BadData(
            f"columns cov_*: row {int(np.argmin(lowest))} is no covariance: it is not positive definite"
        )
    R = (
        np.moveaxis(Rotation.from_quat(quat.T, scalar_first=True).as_matrix(), 0, -1)
        if quat.size
        else np.zeros((3, 3, 0))
    )
    return Campaign(
        arm_name=str(column["arm"][0]) if column["arm"].size else "",
        group=column["group"].astype(np.int64),
        branch=tuple(str(name) for name in column["branch"]),
        believed=BelievedPoses(motor, backlash, friction, side, gravity, turret_kg[0]),
        measured=MeasuredPoses(Pose(R, p), covariance),
        targets_seen=np.array([column[name] for name in COUNT_COLUMNS[1:]]).astype(np.int64),
        misfit_m=misfit_m[0],
        tracker_moved_m=moved_m[0],
    )
