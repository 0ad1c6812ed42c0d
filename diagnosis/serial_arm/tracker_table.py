"""Measured poses from a table, with a mapping that assigns the columns."""

import hashlib
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.arrays import Array
from diagnosis.serial_arm.poses import Pose
from diagnosis.serial_arm.series import PoseSeries, move_directions
from ground.telemetry.imports.files import BadImport
from ground.telemetry.imports.mapping import CsvFormat, TimeMapping
from ground.telemetry.imports.table import InputTable, read_table
from ground.telemetry.imports.times import sort_by_time
from ground.telemetry.imports.units import UNIT_CONVERSIONS
from sim.scenario.names import did_you_mean
from sim.scenario.toml_lines import NotToml, parse_toml
from sim.scenario.toml_record import Findings, read_record

MIN_STALE_ROWS: Final = 3
"""Number of identical measurements in a row, with a moving arm, that proves that the target was lost."""


@dataclass(frozen=True, slots=True)
class QuantityColumns:
    """Columns of one quantity with their unit."""

    columns: tuple[str, ...]
    unit: str


@dataclass(frozen=True, slots=True)
class RotationColumns:
    """Three Euler angles of the target; capital letters mean intrinsic rotations."""

    columns: tuple[str, str, str]
    unit: str
    order: Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]


@dataclass(frozen=True, slots=True)
class TrackerMapping:
    """Mapping from columns of a table to quantities."""

    joints: QuantityColumns
    position: QuantityColumns
    rotation: RotationColumns
    arm: str = "unknown"
    csv: CsvFormat = field(default_factory=CsvFormat)
    time: TimeMapping | None = None
    """Column of time; None if the rows are in the order of time."""
    air: QuantityColumns | None = None


def mapping_from_toml(text: str, file: str) -> TrackerMapping:
    """Read a mapping from TOML.

    Args:
        text: Content of the file.
        file: Name of the file in messages.

    Returns:
        The mapping.

    Raises:
        BadImport: The file is wrong; the message lists every problem with its line.
    """
    try:
        data, lines = parse_toml(text)
    except NotToml as error:
        raise BadImport([f"{file}:{error.line}: {error}"]) from error
    findings = Findings(lines)
    mapping = read_record(TrackerMapping, data, (), findings)
    if mapping is not None:
        _check_quantities(mapping, findings)
    if mapping is None or findings.problems:
        raise BadImport(f"{file}:{p.line}: {p.text}" for p in sorted(findings.problems))
    return mapping


def _check_quantities(mapping: TrackerMapping, findings: Findings) -> None:
    """Check units and number of columns of each quantity."""
    quantities = (
        ("joints", mapping.joints, "rad", None),
        ("position", mapping.position, "m", 3),
        ("rotation", mapping.rotation, "rad", 3),
        ("air", mapping.air, "degC", 1),
    )
    for name, one, kind, count in quantities:
        if one is None:
            continue
        if one.unit not in UNIT_CONVERSIONS[kind]:
            known = did_you_mean(one.unit, UNIT_CONVERSIONS[kind])
            findings.report((name, "unit"), f"unit: {one.unit!r} does not fit; {known}")
        if count is not None and len(one.columns) != count:
            findings.report((name, "columns"), f"columns: {len(one.columns)} given; {name} takes {count}")


def series_from_table(data: bytes, file: str, mapping: TrackerMapping) -> PoseSeries:
    """Read the poses of a table, in order of time.

    Args:
        data: Content of the file.
        file: Name of the file in messages.
        mapping: Columns of each quantity.

    Returns:
        The series.

    Raises:
        BadImport: A column or a value is missing, or the tracker readings stood still while the arm moved.
    """
    air_columns = () if mapping.air is None else mapping.air.columns
    times = () if mapping.time is None or mapping.time.column is None else (mapping.time.column,)
    names = (*mapping.joints.columns, *mapping.position.columns, *mapping.rotation.columns, *air_columns)
    table = read_table(data, file, tuple(dict.fromkeys((*times, *names))), mapping.csv)
    if mapping.time is not None:
        table = sort_by_time(table, mapping.time)
    joints = _values(table, mapping.joints, "rad")
    position = _values(table, mapping.position, "m")
    angles = _values(table, mapping.rotation, "rad")
    _check_stale(table, joints, np.concatenate([position, angles]), mapping.position.columns[0])
    R = np.moveaxis(Rotation.from_euler(mapping.rotation.order, angles.T).as_matrix(), 0, -1)
    air = None if mapping.air is None else _values(table, mapping.air, "degC")[0]
    row = np.array([table.row_number(k) for k in range(table.rows)])
    return PoseSeries(file, joints, move_directions(joints), Pose(R, position), air, row)


def sha256(data: bytes) -> str:
    """Compute the SHA-256 digest of a file's content."""
    return hashlib.sha256(data).hexdigest()


def _values(table: InputTable, quantity: QuantityColumns | RotationColumns, kind: str) -> Array:
    """Read the columns of a quantity in SI units (temperatures in Celsius), shape (columns, n)."""
    unit = UNIT_CONVERSIONS[kind][quantity.unit]
    rows = []
    for name in quantity.columns:
        column = table.numbers(name)
        values = column.values.astype(np.float64)
        missing = np.flatnonzero(~column.given | ~np.isfinite(values))
        if missing.size:
            what = "has no value; leave poses out of the table whose joints or target were not measured"
            raise table.error_at(what, int(missing[0]), name)
        rows.append(values * unit.factor + unit.offset)
    return np.array(rows)


def _check_stale(table: InputTable, joint_rad: Array, measured: Array, column: str) -> None:
    """Check that measurements change when the arm moves."""
    is_stale = np.all(np.diff(measured, axis=1) == 0.0, axis=0) & np.any(
        np.diff(joint_rad, axis=1) != 0.0, axis=0
    )
    run = np.convolve(is_stale, np.ones(MIN_STALE_ROWS - 1, int), "valid") == MIN_STALE_ROWS - 1
    if run.any():
        row = int(np.flatnonzero(run)[0])
        what = (
            f"the target stands still to the last digit in {MIN_STALE_ROWS} rows or more while the joints "
            "move: "
            "the tracker had lost it; leave these rows out"
        )
        raise table.error_at(what, row, column)
