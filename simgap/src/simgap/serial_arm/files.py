"""Files of a serial arm: its TOML file, read and written, and tables of measured poses with their mapping."""

import re
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import ConfigDict, Field, field_validator, model_validator
from scipy.spatial.transform import Rotation

from simgap.arrays import Array, Integers
from simgap.common.errors import RobotError
from simgap.common.toml import Record, parse_record, read_toml, toml_text
from simgap.files.log_file import LogFile, open_log, read_times
from simgap.files.robot_file import CsvTable, Text
from simgap.serial_arm.chain import Pose, PoseSeries, move_directions
from simgap.serial_arm.model import Link, Repeatability, SerialArm, Uncertainty, UPRIGHT_B_m_s2, Vector
from simgap.units import COUNTS, SHARES, Quantity, Unit, find_unit

MOST_LINKS: Final = 20
"""Most links of an arm: the fit of more would take minutes."""


class ArmFile(Record):
    """Content of a file."""

    model_config = ConfigDict(strict=False)  # tables become dataclasses, lists tuples; numbers stay strict

    name: Annotated[str, Field(min_length=1)]
    gravity_B_m_s2: Vector = UPRIGHT_B_m_s2
    link: Annotated[list[Link], Field(min_length=1, max_length=MOST_LINKS)]
    uncertainty: Uncertainty = Uncertainty()
    repeatability: Repeatability = Repeatability()

    @field_validator("link")
    @classmethod
    def _check_names(cls, links: list[Link]) -> list[Link]:
        names = ["base", "target", *(one.name for one in links)]
        taken = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if taken is not None:
            raise ValueError(f"name {taken!r} is taken already; give each link its own")
        return links


def read_arm(path: Path) -> SerialArm:
    """Read an arm from its file; RobotError, with the path of the key, if it is wrong."""
    content = parse_record(ArmFile, read_toml(path), path)
    return SerialArm(
        content.name, tuple(content.link), content.gravity_B_m_s2, content.uncertainty, content.repeatability
    )


def arm_to_toml(arm: SerialArm, about: Iterable[str]) -> str:
    """Format an arm as TOML, from which every bit can be read again."""
    table: dict[str, Any] = {"name": arm.name, "gravity_B_m_s2": arm.gravity_B_m_s2}
    table |= {"link": [_set_fields(one) for one in arm.links]}
    table |= {"uncertainty": _set_fields(arm.uncertainty), "repeatability": _set_fields(arm.repeatability)}
    return toml_text(table, about)


def _set_fields(record: Any) -> dict[str, Any]:
    values = ((one.name, getattr(record, one.name)) for one in fields(record))
    return {name: value for name, value in values if value is not None}


MIN_STALE_ROWS: Final = 3
"""Number of identical measurements in a row, with a moving arm, that proves that the target was lost."""
COLUMNS: Final = {"euler": 3, "rotation vector": 3, "quaternion": 4, "matrix": 9}
"""Columns of each form of a rotation."""
EULER_ORDER: Final = re.compile(r"(?!.*(.)\1)([XYZ]{3}|[xyz]{3})")
"""Three axes, none the same as the one before it."""
QUATERNION_ORDERS: Final = ("wxyz", "xyzw")
ROUNDING: Final = 0.005
"""Largest root mean square by which quaternions and matrices may differ from the nearest rotation.

Numbers rounded to two decimals differ by at most this from a rotation, so from the nearest one, too.
"""


class TableColumns(Record):
    """Columns of one quantity with their unit."""

    columns: Annotated[list[Text], Field(min_length=1)]
    unit: Text

    def convert(self, quantity: Quantity) -> Unit:
        """Return the unit; an error names those that there are."""
        if self.unit in (*COUNTS, *SHARES):
            raise ValueError(f"{self.unit!r} needs a range; convert the column to radians or degrees")
        return find_unit(self.unit, quantity)


class RotationColumns(TableColumns):
    """Rotation of the target in the frame of the tracker."""

    form: Literal["euler", "rotation vector", "quaternion", "matrix"] = "euler"
    """The nine columns of a matrix are its rows, one after the other."""
    unit: str = ""
    """Unit of angles and of rotation vectors; quaternions and matrices have none."""
    order: str = ""
    """Axes of Euler angles, capital letters for intrinsic rotations; of a quaternion, wxyz or xyzw."""

    @model_validator(mode="after")
    def _check_form(self) -> "RotationColumns":
        count, there = COLUMNS[self.form], len(self.columns)
        if there != count:
            raise ValueError(f"columns: there are {there}; a rotation as {self.form} has {count}")
        match self.form:
            case "euler":
                is_order, right = bool(EULER_ORDER.fullmatch(self.order)), "three axes as XYZ, ZYZ or xyz"
            case "quaternion":
                is_order, right = self.order in QUATERNION_ORDERS, "wxyz or xyzw"
            case _:
                is_order, right = not self.order, f"left out for form = {self.form!r}"
        if not is_order:
            raise ValueError(f"order: should be {right}, not {self.order!r}")
        if self.unit and self.form in ("quaternion", "matrix"):
            raise ValueError(f"unit: a {self.form} has none; leave it out")
        return self

    def convert(self, quantity: Quantity) -> Unit:
        """Return the unit; an error names those that there are."""
        return Unit(quantity, 1.0) if self.form in ("quaternion", "matrix") else super().convert(quantity)

    def rotations(self, value: Array) -> tuple[Array, Integers]:
        """Convert the values of the columns to rotation matrices.

        Args:
            value: Angles, rotation vectors [rad], quaternions or matrices, (columns, n).

        Returns:
            The matrices, (3, 3, n), and the indices of the rows that are no rotation.
        """
        rows = value.T
        if self.form == "euler":
            return _stacked(Rotation.from_euler(self.order, rows)), np.array([], int)
        if self.form == "rotation vector":
            return _stacked(Rotation.from_rotvec(rows)), np.array([], int)
        if self.form == "quaternion":
            scalar_first = self.order == "wxyz"
            usable = np.any(rows != 0.0, axis=1)
            turned = Rotation.from_quat(
                np.where(usable[:, None], rows, (0.5, 0.5, 0.5, 0.5)), scalar_first=scalar_first
            )
            nearest = turned.as_quat(scalar_first=scalar_first)
        else:
            square = rows.reshape(-1, 3, 3)
            usable = np.linalg.det(square) > 0.0
            turned = Rotation.from_matrix(np.where(usable[:, None, None], square, np.eye(3)))
            nearest = turned.as_matrix().reshape(-1, 9)
        error = np.sqrt(np.mean((nearest - rows) ** 2, axis=1))
        return _stacked(turned), np.flatnonzero(~usable | (error > ROUNDING))


def _stacked(rotations: Rotation) -> Array:
    return np.asarray(np.moveaxis(rotations.as_matrix(), 0, -1))


class TimeColumn(Record):
    """Time by which rows are sorted."""

    column: Text
    format: str = ""
    """Format of a column of text, as for strptime; empty: the column has numbers."""
    sort: bool = False
    """True to sort the rows; else rows out of order are an error."""


class TrackerMapping(Record):
    """Mapping from columns of a table to quantities."""

    joints: TableColumns
    position: TableColumns
    rotation: RotationColumns
    arm: str = "unknown"
    csv: CsvTable = CsvTable()
    time: TimeColumn | None = None
    """Column of time; None if the rows are in the order of time."""
    air: TableColumns | None = None

    @field_validator("position")
    @classmethod
    def _check_count(cls, given: TableColumns) -> TableColumns:
        if len(given.columns) != 3:
            raise ValueError(f"columns: there are {len(given.columns)}; give three")
        return given

    @model_validator(mode="after")
    def _check_units(self) -> "TrackerMapping":
        for name, quantity in QUANTITIES.items():
            one: TableColumns | None = getattr(self, name)
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
    """Read a mapping from its file; RobotError, with the path of the key, if it is wrong."""
    return parse_record(TrackerMapping, read_toml(path), path)


def read_series(arm: SerialArm, table: Path, mapping: Path) -> PoseSeries:
    """Read the poses of a table in order of time; RobotError if a file is wrong, or of another arm."""
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
    """Read the poses of a table in order of time; RobotError if a value is wrong or the tracker still."""
    given = {name: one for name in QUANTITIES if (one := getattr(mapping, name)) is not None}
    numbers = [name for one in given.values() for name in one.columns]
    time = mapping.time
    texts = [time.column] if time is not None and time.format else []
    if time is not None and not time.format:
        numbers.append(time.column)
    log = open_log(path, list(dict.fromkeys(numbers)), texts, mapping.csv)
    order = _order(log, time)
    values = {name: _values(log, one, QUANTITIES[name], order) for name, one in given.items()}
    joints, position = values["joints"], values["position"]
    row = np.arange(1, joints.shape[1] + 1) if order is None else order + 1
    _check_stale(path, row, joints, np.concatenate([position, values["rotation"]]))
    R, wrong = mapping.rotation.rotations(values["rotation"])
    if wrong.size:
        raise RobotError(
            f"{path}: row {row[wrong[0]]}, columns {', '.join(mapping.rotation.columns)}: are no rotation "
            f"as a {mapping.rotation.form}; see that columns and order are right"
        )
    air = values["air"][0] if "air" in values else None
    return PoseSeries(str(path), joints, move_directions(joints), Pose(R, position), air, row)


def _order(log: LogFile, time: TimeColumn | None) -> Integers | None:
    """Return the rows of the file in order of time, (n,); None for the order of the file."""
    if time is None:
        return None
    at = read_times(log, time.column, time.format)
    late = np.flatnonzero(np.diff(at) < 0)
    if late.size and not time.sort:
        raise RobotError(
            f"{log.path}: row {late[0] + 2}, column {time.column!r}: is before the row above; sort the "
            "table, or write sort = true in [time]"
        )
    return np.argsort(at, kind="stable") if time.sort else None


def _values(log: LogFile, columns: TableColumns, quantity: Quantity, order: Integers | None) -> Array:
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
        named = ", ".join(columns.columns)
        raise RobotError(f"{log.path}: columns {named}: are not equally long; give a table")
    return np.array(rows)


def _check_stale(path: Path, row: Integers, joint_rad: Array, measured: Array) -> None:
    """Check that measurements change when the arm moves."""
    stands, moves = np.diff(measured, axis=1) == 0.0, np.diff(joint_rad, axis=1) != 0.0
    is_stale = np.all(stands, axis=0) & np.any(moves, axis=0)
    run = np.convolve(is_stale, np.ones(MIN_STALE_ROWS - 1, int), "valid") == MIN_STALE_ROWS - 1
    if run.any():
        raise RobotError(
            f"{path}: row {row[np.flatnonzero(run)[0]]}: the target stands still to the last digit in "
            f"{MIN_STALE_ROWS} rows or more while the joints move: the tracker had lost it; "
            "leave these rows out"
        )
