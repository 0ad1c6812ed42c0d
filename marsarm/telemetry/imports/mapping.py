"""Records of a checked mapping: columns and channels, time, format of the text, start and session."""

from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params
from fsw.dictionary.types import Limits
from fsw.estimate.reference import Reference
from marsarm.telemetry.imports.targets import ChannelTarget
from marsarm.telemetry.imports.units import Conversion
from simgap.common.toml import KeyPath

GridMode = Literal["exact", "nearest", "hold", "linear"]
TICK: Final = "tick"
"""Value of a mapping that stands for the number of the cycle."""
MAX_TICK: Final = 1 << 39
"""Limit of the first tick and of the span of a table, 272 years; more nanoseconds do not fit a log."""
UNIT_NS: Final = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}


@dataclass(frozen=True, slots=True)
class TimeMapping:
    """Table [time]: times of the rows, and treatment of rows between two cycles."""

    column: str | None = None
    unit: Literal["s", "ms", "us", "ns"] | None = None
    format: str | None = None
    """Format of a column of text, as for strptime."""
    rate_Hz: Annotated[float | None, Limits(1e-3, 1e6)] = None
    """Rate of the rows of a table without a time column."""
    grid: GridMode = "exact"
    tolerance_cycles: Annotated[float, Limits(0.0, 0.5)] = 0.01
    """Largest distance of a row from its cycle, in cycles, with grid "exact"."""
    max_interval_s: Annotated[float, Limits(1e-3, 60.0)] = 1.0
    """Longest time without a row, with grids "hold" and "linear"."""
    sort: bool = False
    """True to sort the rows by time; else rows out of order are an error."""
    first_tick: int = 0
    """Tick of the first row."""

    def __post_init__(self) -> None:
        """Check that exactly one source of times is given."""
        if (self.column is None) == (self.rate_Hz is None):
            raise ValueError(
                "time: give column and unit, or rate_Hz for rows at a fixed rate; one of the two"
            )
        if self.column is None and (self.unit is not None or self.format is not None):
            raise ValueError("time: unit and format are of a column; with rate_Hz leave them out")
        if self.unit is not None and self.format is not None:
            raise ValueError("time: unit is of numbers, format of text; give one of the two")
        if not 0 <= self.first_tick < MAX_TICK:
            raise ValueError(f"time: first_tick {self.first_tick} is outside 0 .. {MAX_TICK}")


@dataclass(frozen=True, slots=True)
class CsvFormat:
    """Table [csv]: separator and decimal sign of a text table."""

    separator: str = ","
    decimal: Literal[".", ","] = "."

    def __post_init__(self) -> None:
        """Check that the separator is one character and not the decimal sign."""
        if len(self.separator) != 1 or not self.separator.isascii() or self.separator in '"\r\n':
            raise ValueError(
                f"csv: separator {self.separator!r} is not one character; write ',' or ';' or a tab"
            )
        if self.separator == self.decimal:
            raise ValueError(f"csv: separator and decimal are both {self.decimal!r}; one of them is another")


@dataclass(frozen=True, slots=True, eq=False)
class MappedChannel:
    """Field of a message, and the columns or the constant that give its values."""

    target: ChannelTarget
    columns: tuple[str, ...]
    """Columns of the table; empty for a constant."""
    constant: NDArray[Any] | str | None
    """Constant in the type of the log, or TICK."""
    conversion: Conversion
    gain: NDArray[np.float64]
    offset: NDArray[np.float64]
    place: KeyPath
    """Place in the mapping."""


@dataclass(frozen=True, slots=True)
class TimedCommand:
    """Command, and the tick of the first cycle that receives it."""

    tick: int
    command: Command
    place: KeyPath
    """Place in the mapping."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightStart:
    """Table [start]: start conditions of flight software, for replay."""

    params: Params
    mode: Mode
    reference: Reference | None
    commands: tuple[TimedCommand, ...]
    """Commands in order of their ticks."""


@dataclass(frozen=True, slots=True)
class SessionMapping:
    """Table [session]: motion and conditions, for the diagnosis."""

    name: str
    block: str | None = None
    """Name that all repeats of a motion share; None for the name of the session."""
    temperature_C: Annotated[float | None, Limits(-273.15, 1000.0)] = None
    """Temperature of the air; None for that of the windings in the first row."""


@dataclass(frozen=True, slots=True, eq=False)
class TableMapping:
    """Checked mapping."""

    file: str
    arm: str
    time: TimeMapping
    csv: CsvFormat
    channels: tuple[MappedChannel, ...]
    start: FlightStart | None
    session: SessionMapping | None
