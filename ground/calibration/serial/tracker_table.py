"""Poses that a tracker measured, from a table and a mapping that says which columns are what."""

import hashlib
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.kinematics.transforms import Array, Pose
from ground.calibration.serial.series import PoseSeries, move_directions
from ground.telemetry.imports.files import BadImport
from ground.telemetry.imports.mapping import CsvFormat, TimeMapping
from ground.telemetry.imports.table import InputTable, read_table
from ground.telemetry.imports.times import sort_by_time
from ground.telemetry.imports.units import UNIT_CONVERSIONS
from sim.scenario.names import did_you_mean
from sim.scenario.toml_lines import NotToml, parse_toml
from sim.scenario.toml_record import Findings, read_record

MIN_STALE_ROWS: Final = 3
"""So many poses in a row, exactly alike though the arm moved: the tracker had lost its target."""


@dataclass(frozen=True, slots=True)
class QuantityColumns:
    """Columns of one quantity, and the unit that they are in."""

    columns: tuple[str, ...]
    unit: str


@dataclass(frozen=True, slots=True)
class RotationColumns:
    """Three angles of the target, about axes in this order; capitals if each axis turns with those before."""

    columns: tuple[str, str, str]
    unit: str
    order: Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]


@dataclass(frozen=True, slots=True)
class TrackerMapping:
    """What a mapping says."""

    joints: QuantityColumns
    position: QuantityColumns
    rotation: RotationColumns
    arm: str = "unknown"
    csv: CsvFormat = field(default_factory=CsvFormat)
    time: TimeMapping | None = None
    """None where the rows are in the order of time."""
    air: QuantityColumns | None = None


def mapping_from_toml(text: str, file: str) -> TrackerMapping:
    """The mapping that a TOML text says; `file` is how messages call it.

    Raises:
        BadImport: something in it is wrong; the message has every problem, by line.
    """
    try:
        data, lines = parse_toml(text)
    except NotToml as error:
        raise BadImport([f"{file}:{error.line}: {error}"]) from error
    findings = Findings(lines)
    said = read_record(TrackerMapping, data, (), findings)
    if said is not None:
        _check_quantities(said, findings)
    if said is None or findings.problems:
        raise BadImport(f"{file}:{p.line}: {p.text}" for p in sorted(findings.problems))
    return said


def _check_quantities(said: TrackerMapping, findings: Findings) -> None:
    """Refuse a unit that is of another quantity, and columns that are too few or too many."""
    quantities = (
        ("joints", said.joints, "rad", None),
        ("position", said.position, "m", 3),
        ("rotation", said.rotation, "rad", 3),
        ("air", said.air, "degC", 1),
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
    """The poses of a table, in order of time.

    Raises:
        BadImport: it lacks a column or a value, or the tracker stood still while the arm moved.
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
    """Digest of a file."""
    return hashlib.sha256(data).hexdigest()


def _values(table: InputTable, said: QuantityColumns | RotationColumns, kind: str) -> Array:
    """In the unit of the house, (columns, n)."""
    unit = UNIT_CONVERSIONS[kind][said.unit]
    rows = []
    for name in said.columns:
        column = table.numbers(name)
        values = column.values.astype(np.float64)
        lacking = np.flatnonzero(~column.given | ~np.isfinite(values))
        if lacking.size:
            what = "has no value; leave poses out of the table whose joints or target were not measured"
            raise table.wrong(what, int(lacking[0]), name)
        rows.append(values * unit.factor + unit.offset)
    return np.array(rows)


def _check_stale(table: InputTable, joint_rad: Array, measured: Array, column: str) -> None:
    """Refuse measurements that stay the same to the last digit while the arm moves."""
    alike = np.all(np.diff(measured, axis=1) == 0.0, axis=0) & np.any(
        np.diff(joint_rad, axis=1) != 0.0, axis=0
    )
    run = np.convolve(alike, np.ones(MIN_STALE_ROWS - 1, int), "valid") == MIN_STALE_ROWS - 1
    if run.any():
        row = int(np.flatnonzero(run)[0])
        what = (
            f"the target stands still to the last digit in {MIN_STALE_ROWS} rows or more while the joints "
            "move: "
            "the tracker had lost it; leave these rows out"
        )
        raise table.wrong(what, row, column)
