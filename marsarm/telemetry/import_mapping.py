"""Mapping of an import: a file in the form of a robot file, and the channels that it may name."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Bounds
from pydantic import model_validator

from fsw.config import configure
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from marsarm.telemetry.format import DRIVE_TOPIC, SENSOR_TOPIC
from marsarm.telemetry.schema import Field, Layout, arm_names, packet_layout, unit_of
from marsarm.telemetry.topics import PACKET_TOPICS
from sim.arms import nominal_params, params_over_nominal
from sim.params import BadParams
from simgap.common.errors import RobotError
from simgap.common.toml import Record
from simgap.files.robot_file import CsvTable, TimeTable
from simgap.units import COUNTS, SHARES, UNITS, Quantity, Unit, find_unit

TOPICS: Final = (SENSOR_TOPIC, DRIVE_TOPIC)
CYCLE: Final = f"{SENSOR_TOPIC}.cycle"
"""Channel that needs no column: it counts the cycles."""
PLAIN_UNITS: Final = ("bool", "count")
"""Units of the log that a mapping need not name, for nothing else could be meant."""
Array = NDArray[np.float64]


class GridTime(TimeTable):
    """Times of the rows, and what becomes of rows between two cycles."""

    grid: Literal["exact", "linear"] = "exact"


class SessionTable(Record):
    """Motion and conditions, for the diagnosis."""

    name: str
    block: str | None = None
    """Name that all repeats of a motion share; absent: the name of the session."""
    temperature_C: Annotated[float, Bounds(ge=-273.15, le=1000.0)] | None = None
    """Temperature of the air; absent: that of the windings in the first row."""


PerJoint = Annotated[list[float], Bounds(min_length=5, max_length=5)]


class ReferenceTable(Record):
    """Zeros of the joints and more that an initialisation finds, for the diagnosis; in the order of Joint."""

    zero_rad: PerJoint
    calibrated: Annotated[list[bool], Bounds(min_length=5, max_length=5)] = [True] * 5
    half_backlash_rad: PerJoint | None = None
    """Absent: of the parameters."""
    resolver_bias_rad: PerJoint = [0.0] * 5
    friction_Nm: PerJoint | None = None


class ChannelTable(Record):
    """Columns of one channel, or its constant."""

    columns: str | list[str] = Bounds(default_factory=list)
    """A column for each number of the channel."""
    value: float | list[float] | None = None
    """Constant in place of columns."""
    unit: str = ""
    """Unit of factor * column + offset."""
    factor: float | list[float] = 1.0
    """Multiplies the columns: one number, or one for each."""
    offset: float | list[float] = 0.0

    @model_validator(mode="after")
    def _check(self) -> "ChannelTable":
        if bool(self.columns) == (self.value is not None):
            raise ValueError("give columns, or value for what never changes; one of the two")
        return self


class MappingFile(Record):
    """Content of a mapping."""

    arm: str = "unknown"
    time: GridTime = GridTime()
    csv: CsvTable = CsvTable()
    session: SessionTable | None = None
    params: str = ""
    """Parameters of the arm over the nominal ones, relative to the mapping; empty: the nominal ones."""
    reference: ReferenceTable | None = None
    channels: Annotated[dict[str, ChannelTable], Bounds(min_length=1)]


@dataclass(frozen=True, slots=True, eq=False)
class MappedChannel:
    """Field of a message, and the column or constant of each of its numbers, in the unit of the log."""

    where: str
    """Place of the channel in the mapping, for errors."""
    name: str
    field: Field
    columns: tuple[str, ...]
    """Columns of the table; empty for a constant."""
    constant: Array
    factor: Array
    """One for each number; the offset too."""
    offset: Array
    is_rounded: bool
    """True if a factor or an offset asks to round whole numbers."""


@cache
def layout_of(topic: str) -> Layout:
    """Return the layout of a flight topic, as the recorder writes it."""
    packet, names = PACKET_TOPICS[topic].packet, PACKET_TOPICS[topic].field_names
    return packet_layout(packet, names, arm_names(nominal_params()))


@cache
def known_channels() -> dict[str, Field]:
    """Return every field by the name of its channel, but for the one that counts cycles."""
    fields = {f"{topic}.{one.name}": one for topic in TOPICS for one in layout_of(topic).fields}
    return {name: one for name, one in fields.items() if name != CYCLE}


def read_params(mapping: Path, name: str) -> Params:
    """Read the parameters of the arm of a mapping; RobotError if they are wrong."""
    try:
        return params_over_nominal(mapping.parent / name) if name else nominal_params()
    except (BadParams, OSError, ValueError) as error:
        raise RobotError(f"{mapping}: params: {error}") from error


def stored_reference(table: ReferenceTable, params: Params) -> Reference:
    """Return the stored reference of the joints."""
    backlash, friction = table.half_backlash_rad, table.friction_Nm
    return Reference(
        calibrated=np.array(table.calibrated),
        known=np.array(table.calibrated),
        zero_rad=np.array(table.zero_rad),
        half_backlash_rad=configure(params).half_backlash_rad if backlash is None else np.array(backlash),
        resolver_bias_rad=np.array(table.resolver_bias_rad),
        friction_Nm=np.full(len(Joint), np.inf) if friction is None else np.array(friction),
    )


def map_channels(path: Path, tables: Mapping[str, ChannelTable]) -> dict[str, list[MappedChannel]]:
    """Return the channels by topic; RobotError if one is wrong, or a topic lacks one."""
    found: dict[str, list[MappedChannel]] = {}
    for name, one in tables.items():
        mapped = _map_channel(f"{path}: channels.{name}", name, one)
        found.setdefault(name.partition(".")[0], []).append(mapped)
    for topic, channels in found.items():
        names = {one.name for one in channels}
        lacks = [name for name in known_channels() if name.startswith(f"{topic}.") and name not in names]
        if lacks:
            raise RobotError(f"{path}: channels: {topic} lacks {', '.join(lacks)}; map each, or none of it")
        if not any(one.columns for one in channels):
            raise RobotError(f"{path}: channels: all of {topic} is constant; give a column of it")
    return found


def _map_channel(where: str, name: str, table: ChannelTable) -> MappedChannel:
    if name == CYCLE:
        raise RobotError(f"{where}: it counts the cycles; remove it")
    if name not in known_channels():
        near = get_close_matches(name, known_channels(), 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise RobotError(f"{where}: is not known; {hint}there are {', '.join(known_channels())}")
    field = known_channels()[name]
    size = int(np.prod(field.shape or ()))
    columns = (table.columns,) if isinstance(table.columns, str) else tuple(table.columns)
    if len(set(columns)) < len(columns):
        raise RobotError(f"{where}.columns: one is there twice; each number has a column of its own")
    if columns and len(columns) != size:
        raise RobotError(f"{where}.columns: {len(columns)} given; {name} takes {size}")
    value = 0.0 if table.value is None else table.value
    factor, offset, constant = (
        _number_each(f"{where}.{key}", given, size)
        for key, given in (("factor", table.factor), ("offset", table.offset), ("value", value))
    )
    unit = _conversion(where, name, field, table.unit)
    return MappedChannel(
        where=where,
        name=name,
        field=field,
        columns=columns,
        constant=constant,
        factor=unit.factor * factor,
        offset=unit.factor * offset + unit.offset,
        is_rounded=bool(np.any(factor != 1.0) or np.any(offset)),
    )


def _number_each(where: str, given: float | list[float], size: int) -> Array:
    """Return a number for each column; RobotError if there are neither one nor as many."""
    if isinstance(given, list) and len(given) != size:
        raise RobotError(f"{where}: {len(given)} given; write one for all, or {size}")
    return np.broadcast_to(np.array(given, np.float64), size)


def _conversion(where: str, name: str, field: Field, unit: str) -> Unit:
    """Return the conversion of a unit to that of the log."""
    kept = "bool" if field.kind == "|b1" else unit_of(field.name) or ""
    if unit == kept or (not unit and kept in PLAIN_UNITS):
        return Unit(Quantity.RATIO, 1.0)
    if kept in PLAIN_UNITS:
        raise RobotError(f"{where}.unit: {unit!r} does not fit; {name} is kept in {kept}, write that")
    if not unit:
        raise RobotError(f"{where}.unit: is missing; {name} is kept in {kept}")
    base = UNITS[kept]
    try:
        found = find_unit(unit, base.quantity, without=(*COUNTS, *SHARES))  # nothing tells their range
    except ValueError as error:
        raise RobotError(f"{where}.unit: {error}; {name} is kept in {kept}") from error
    return Unit(found.quantity, found.factor / base.factor, (found.offset - base.offset) / base.factor)
