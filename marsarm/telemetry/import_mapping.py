"""Mapping of an import: a file in the form of a robot file, and the channels that it may name."""

import re
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field as Bounds
from pydantic import model_validator

from fsw.config import configure
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from marsarm.telemetry.schema import ROS_NAME, Field, Layout, arm_names, packet_layout, unit_of
from marsarm.telemetry.topics import PACKET_TOPICS
from sim.arms import nominal_params, params_over_nominal
from sim.params import BadParams
from simgap.common.errors import RobotError
from simgap.common.toml import Record
from simgap.files.robot_file import CsvTable, TimeTable
from simgap.units import UNITS, Quantity, Unit, find_unit

TICK: Final = "tick"
"""Value of a mapping that stands for the number of the cycle."""
MAX_TICK: Final = 1 << 39
"""Limit of the first tick and of the span of a table, 272 years; more nanoseconds do not fit a log."""
IMPORT_PREFIX: Final = "/imported/"
"""Prefix of the topics that flight software does not have."""
CUSTOM_NAME: Final = re.compile(r"/imported/([a-z](?:_?[a-z0-9]+)*)\.(\w+)")
PLAIN_UNITS: Final = ("bool", "count", "cycle", "1")
"""Units of the log that a mapping need not name, for nothing else could be meant."""
Number = bool | int | float


class GridTime(TimeTable):
    """Times of the rows, and what becomes of rows between two cycles."""

    format: str = ""
    """Format of a time column of text, as for strptime."""
    rate_Hz: Annotated[float, Bounds(gt=0)] | None = None
    """Rate of the rows of a table without a time column."""
    sort: bool = False
    """Sort the rows by time; else rows out of order are an error."""
    first_tick: Annotated[int, Bounds(ge=0, lt=MAX_TICK)] = 0
    """Cycle of the first row."""
    grid: Literal["exact", "nearest", "hold", "linear"] = "exact"
    tolerance_cycles: Annotated[float, Bounds(ge=0, le=0.5)] = 0.01
    """Largest distance of a row from its cycle, with grid "exact"."""
    max_interval_s: Annotated[float, Bounds(gt=0, le=60)] = 1.0
    """Longest time without a row, with grids "hold" and "linear"."""

    @model_validator(mode="after")
    def _check(self) -> "GridTime":
        if self.rate_Hz is not None and (self.column or self.format):
            raise ValueError("give column, or rate_Hz for rows at a fixed rate; one of the two")
        return self


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
    value: Number | list[Number] | Literal["tick"] | None = None
    """Constant in place of columns; `tick` is the number of the cycle."""
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


@dataclass(frozen=True, slots=True)
class ChannelTarget:
    """Field of a message to which columns are mapped."""

    topic: str
    field: Field
    unit: str | None
    """Unit in the log; None for a member of an enumeration."""

    @property
    def name(self) -> str:
        """Name in a mapping."""
        return f"{self.topic}.{self.field.name}"

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(np.prod(self.field.shape or ()))


@dataclass(frozen=True, slots=True, eq=False)
class MappedChannel:
    """Target, and what gives each of its numbers, a column or a constant, in the unit of the log."""

    target: ChannelTarget
    columns: tuple[str, ...]
    """Columns of the table; empty for a constant."""
    constant: tuple[float, ...]
    """Numbers in place of columns; empty for columns and for the number of the cycle."""
    factor: tuple[float, ...]
    """One for each number; the offset too."""
    offset: tuple[float, ...]
    is_rounded: bool
    """True if a factor or an offset asks to round whole numbers."""


def read_params(path: Path, file: MappingFile) -> Params:
    """Read the parameters of the arm of a mapping; RobotError if they are wrong."""
    try:
        return params_over_nominal(path.parent / file.params) if file.params else nominal_params()
    except (BadParams, OSError, ValueError) as error:
        raise RobotError(f"{path}: params: {error}") from error


def map_channels(path: Path, file: MappingFile) -> list[MappedChannel]:
    """Return the channels of a mapping; RobotError if one is wrong."""
    return [_map_channel(f"{path}: channels.{name}", name, one) for name, one in file.channels.items()]


def stored_reference(table: ReferenceTable | None, params: Params) -> Reference | None:
    """Return the stored reference of the joints; None if it is unknown."""
    if table is None:
        return None
    backlash, friction = table.half_backlash_rad, table.friction_Nm
    return Reference(
        calibrated=np.array(table.calibrated),
        known=np.array(table.calibrated),
        zero_rad=np.array(table.zero_rad),
        half_backlash_rad=configure(params).half_backlash_rad if backlash is None else np.array(backlash),
        resolver_bias_rad=np.array(table.resolver_bias_rad),
        friction_Nm=np.full(len(Joint), np.inf) if friction is None else np.array(friction),
    )


def _map_channel(where: str, name: str, table: ChannelTable) -> MappedChannel:
    columns = (table.columns,) if isinstance(table.columns, str) else tuple(table.columns)
    target = known_targets().get(name) or _custom_target(where, name, table)
    if len(set(columns)) < len(columns):
        raise RobotError(f"{where}.columns: one is there twice; each number has a column of its own")
    if columns and len(columns) != target.size:
        raise RobotError(f"{where}.columns: {len(columns)} given; {name} takes {target.size}")
    if table.value == TICK and target.unit != "cycle":
        raise RobotError(f"{where}.value: {name} is no number of a cycle; write numbers")
    factor = _number_each(f"{where}.factor", table.factor, target.size)
    offset = _number_each(f"{where}.offset", table.offset, target.size)
    is_rounded = any(one != 1.0 for one in factor) or any(offset)
    if target.field.members is not None and (table.unit or is_rounded):
        raise RobotError(f"{where}: is the number of a name; it has no unit, factor or offset")
    unit = _conversion(where, target, table.unit)
    return MappedChannel(
        target=target,
        columns=columns,
        constant=()
        if table.value is None or table.value == TICK
        else _number_each(f"{where}.value", table.value, target.size),
        factor=tuple(unit.factor * one for one in factor),
        offset=tuple(unit.factor * one + unit.offset for one in offset),
        is_rounded=is_rounded,
    )


def _number_each(where: str, given: Any, size: int) -> tuple[float, ...]:
    """Return a number for each column; RobotError if there are neither one nor as many."""
    numbers = given if isinstance(given, list) else [given] * size
    if len(numbers) != size:
        raise RobotError(f"{where}: {len(numbers)} given; write one for all, or {size}")
    return tuple(map(float, numbers))


def _conversion(where: str, target: ChannelTarget, name: str) -> Unit:
    """Return the conversion of a unit to that of the log."""
    kept = target.unit
    if kept is None or name == kept or (not name and kept in PLAIN_UNITS):
        return Unit(Quantity.RATIO, 1.0)
    if kept not in UNITS or kept == "count":
        raise RobotError(f"{where}.unit: {name!r} does not fit; {target.name} is kept in {kept}, write that")
    try:
        unit = find_unit(name, UNITS[kept].quantity)
    except ValueError as error:
        raise RobotError(f"{where}.unit: {error}; {target.name} is kept in {kept}") from error
    base = UNITS[kept]
    return Unit(unit.quantity, unit.factor / base.factor, (unit.offset - base.offset) / base.factor)


@cache
def topic_layout(name: str) -> Layout:
    """Return the layout of a flight topic, as the recorder writes it."""
    return packet_layout(
        PACKET_TOPICS[name].packet, PACKET_TOPICS[name].field_names, arm_names(nominal_params())
    )


@cache
def known_targets() -> dict[str, ChannelTarget]:
    """Return every flight channel by name."""
    found = {}
    for topic in PACKET_TOPICS:
        for field in topic_layout(topic).fields:
            unit = None if field.members else "bool" if field.kind == "|b1" else unit_of(field.name)
            found[f"{topic}.{field.name}"] = ChannelTarget(topic, field, unit)
    return found


def _custom_target(where: str, name: str, table: ChannelTable) -> ChannelTarget:
    """Return a channel that only the table has, by a name that ends in a unit; RobotError if it is wrong."""
    if not name.startswith(IMPORT_PREFIX):
        near = get_close_matches(name, known_targets(), 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise RobotError(
            f"{where}: is not known; {hint}`marsarm dictionary '/*'` lists our channels; write "
            f"{IMPORT_PREFIX}NAME.FIELD for one of your own"
        )
    match = CUSTOM_NAME.fullmatch(name)
    if match is None or not ROS_NAME.fullmatch(match[2].lower()):
        raise RobotError(
            f"{where}: write /imported/NAME.FIELD, words of a-z and 0-9 joined by one _, as "
            "/imported/arm.speed_m_s"
        )
    if f"/{match[1]}" in PACKET_TOPICS:
        raise RobotError(f"{where}: {IMPORT_PREFIX}{match[1]} is reserved for an incomplete /{match[1]}")
    given = table.columns or table.value
    shape = (len(given),) if isinstance(given, list) else None
    kept = unit_of(match[2]) or ("bool" if table.unit in ("bool", "flag") else "1")
    kind = {"bool": "|b1", "count": "<i8", "cycle": "<i8"}.get(kept, "<f8")
    return ChannelTarget(IMPORT_PREFIX + match[1], Field(match[2], kind, shape), kept)
