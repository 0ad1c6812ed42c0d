"""Measured poses from a table, with a mapping that assigns the columns."""

from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field, field_validator, model_validator
from scipy.spatial.transform import Rotation

from simgap.arrays import Array, Integers
from simgap.common.errors import RobotError
from simgap.files.columns import LogFile
from simgap.files.log_file import open_log
from simgap.files.robot_file import CsvTable, Text
from simgap.files.toml_record import Record, parse_record, read_toml
from simgap.serial_arm.arm import SerialArm
from simgap.serial_arm.poses import Pose
from simgap.serial_arm.series import PoseSeries, move_directions
from simgap.units import COUNTS, FRACTION, Quantity, Unit, find_unit

MIN_STALE_ROWS: Final = 3
"""Number of identical measurements in a row, with a moving arm, that proves that the target was lost."""
Order = Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]


class Columns(Record):
    """Columns of one quantity with their unit."""

    columns: Annotated[list[Text], Field(min_length=1)]
    unit: Text

    def convert(self, quantity: Quantity) -> Unit:
        """Return the unit; an error names those that there are."""
        if self.unit in (*COUNTS, FRACTION):
            raise ValueError(f"{self.unit!r} needs a range; convert the column to radians or degrees")
        return find_unit(self.unit, quantity)


class RotationColumns(Columns):
    """Three Euler angles of the target; capital letters mean intrinsic rotations."""

    order: Order


class TimeColumn(Record):
    """Time by which rows are sorted."""

    column: Text
    format: str = ""
    """Format of a column of text, as for strptime; empty: the column has numbers."""
    sort: bool = False
    """True to sort the rows; else rows out of order are an error."""


class TrackerMapping(Record):
    """Mapping from columns of a table to quantities."""

    joints: Columns
    position: Columns
    rotation: RotationColumns
    arm: str = "unknown"
    csv: CsvTable = CsvTable()
    time: TimeColumn | None = None
    """Column of time; None if the rows are in the order of time."""
    air: Columns | None = None

    @field_validator("position", "rotation")
    @classmethod
    def _check_count(cls, given: Columns) -> Columns:
        if len(given.columns) != 3:
            raise ValueError(f"columns: there are {len(given.columns)}; give three")
        return given

    @model_validator(mode="after")
    def _check_units(self) -> "TrackerMapping":
        for name, quantity in QUANTITIES.items():
            one: Columns | None = getattr(self, name)
            if one is not None:
                try:
                    one.convert(quantity)
                except ValueError as error:
                    raise ValueError(f"{name}.unit: {error}") from error
        if self.air is not None and len(self.air.columns) != 1:
            raise ValueError(f"air.columns: there are {len(self.air.columns)}; give one")
        return self


QUANTITIES: Final = {
    "joints": Quantity.ANGLE,
    "position": Quantity.LENGTH,
    "rotation": Quantity.ANGLE,
    "air": Quantity.TEMPERATURE,
}


def read_mapping(path: Path) -> TrackerMapping:
    """Read a mapping from its file.

    Raises:
        RobotError: The file cannot be read or is wrong; the text gives the path of the key.
    """
    return parse_record(TrackerMapping, read_toml(path), path)


def read_series(arm: SerialArm, table: Path, mapping: Path) -> PoseSeries:
    """Read the poses of a table, in order of time.

    Args:
        arm: Arm whose joints the table has.
        table: Table with joint angles and measured poses.
        mapping: File that assigns the columns.

    Returns:
        The series.

    Raises:
        RobotError: A file, a column or a value is missing or wrong, the mapping is that of another arm, or
            the tracker readings stood still while the arm moved.
    """
    meant = read_mapping(mapping)
    columns, joints = len(meant.joints.columns), len(arm.links)
    if columns != joints:
        raise RobotError(f"{mapping}: joints: {columns} columns; the arm {arm.name} has {joints} joints")
    if meant.arm != arm.name:
        raise RobotError(
            f"{mapping}: its table is of the arm {meant.arm!r}, the arm file describes {arm.name!r}; give "
            "the files of one arm"
        )
    return series_from_table(table, meant)


def series_from_table(path: Path, mapping: TrackerMapping) -> PoseSeries:
    """Read the poses of a table, in order of time.

    Args:
        path: Table with joint angles and measured poses.
        mapping: Columns of each quantity.

    Returns:
        The series.

    Raises:
        RobotError: A column or a value is missing, or the tracker readings stood still while the arm moved.
    """
    given = {name: one for name in QUANTITIES if (one := getattr(mapping, name)) is not None}
    numbers = [name for one in given.values() for name in one.columns]
    time = mapping.time
    texts = [time.column] if time is not None and time.format else []
    if time is not None and not time.format:
        numbers.append(time.column)
    log = open_log(path, list(dict.fromkeys(numbers)), texts, mapping.csv)
    order = _order(log, time)
    values = {name: _values(log, one, QUANTITIES[name], order) for name, one in given.items()}
    joints, position, angles = values["joints"], values["position"], values["rotation"]
    row = np.arange(1, joints.shape[1] + 1) if order is None else order + 1
    _check_stale(path, row, joints, np.concatenate([position, angles]))
    R = np.moveaxis(Rotation.from_euler(mapping.rotation.order, angles.T).as_matrix(), 0, -1)
    air = values["air"][0] if "air" in values else None
    return PoseSeries(str(path), joints, move_directions(joints), Pose(R, position), air, row)


def _order(log: LogFile, time: TimeColumn | None) -> Integers | None:
    """Return the rows of the file in order of time, (n,); None for the order of the file."""
    if time is None:
        return None
    if time.format:
        read = pc.strptime(pa.array(log.texts(time.column)), time.format, "us", error_is_null=True)
        bad = np.flatnonzero(read.is_null().to_numpy(zero_copy_only=False))
        at = read.cast(pa.int64()).to_numpy(zero_copy_only=False)
        wrong = f"no time as {time.format!r} has it"
    else:
        at = log.numbers(time.column).value
        bad, wrong = np.flatnonzero(~np.isfinite(at)), "no time; every row needs one"
    if bad.size:
        raise RobotError(f"{log.path}: row {bad[0] + 1}, column {time.column!r}: has {wrong}")
    late = np.flatnonzero(np.diff(at) < 0)
    if late.size and not time.sort:
        raise RobotError(
            f"{log.path}: row {late[0] + 2}, column {time.column!r}: is before the row above; sort the "
            "table, or write sort = true in [time]"
        )
    return np.argsort(at, kind="stable") if time.sort else None


def _values(log: LogFile, columns: Columns, quantity: Quantity, order: Integers | None) -> Array:
    """Read the columns of a quantity in SI units (temperatures in Celsius), shape (columns, n)."""
    unit = columns.convert(quantity)
    rows = []
    for name in columns.columns:
        value = log.numbers(name).value
        missing = np.flatnonzero(~np.isfinite(value))
        if missing.size:
            raise RobotError(
                f"{log.path}: row {missing[0] + 1}, column {name!r}: has no value; leave poses out of the "
                "table whose joints or target were not measured"
            )
        rows.append((value if order is None else value[order]) * unit.factor + unit.offset)
    if len({one.size for one in rows}) > 1:
        raise RobotError(
            f"{log.path}: columns {', '.join(columns.columns)}: are not equally long; give a table"
        )
    return np.array(rows)


def _check_stale(path: Path, row: Integers, joint_rad: Array, measured: Array) -> None:
    """Check that measurements change when the arm moves."""
    is_stale = np.all(np.diff(measured, axis=1) == 0.0, axis=0) & np.any(
        np.diff(joint_rad, axis=1) != 0.0, axis=0
    )
    run = np.convolve(is_stale, np.ones(MIN_STALE_ROWS - 1, int), "valid") == MIN_STALE_ROWS - 1
    if run.any():
        raise RobotError(
            f"{path}: row {row[np.flatnonzero(run)[0]]}: the target stands still to the last digit in "
            f"{MIN_STALE_ROWS} rows or more while the joints move: the tracker had lost it; "
            "leave these rows out"
        )
