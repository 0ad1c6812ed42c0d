"""What a mapping says, once it has been checked: which columns are which channels."""

from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params
from fsw.dictionary.types import Limits
from fsw.estimate.reference import Reference
from ground.telemetry.imports.targets import ChannelTarget
from ground.telemetry.imports.units import Conversion

GridMode = Literal["exact", "nearest", "hold", "linear"]
TICK: Final = "tick"
"""The value that is the number of the cycle."""
MAX_TICK: Final = 1 << 39
"""A table may begin here and span as much: more ticks, in nanoseconds, do not fit a log. 272 years."""
UNIT_NS: Final = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}


@dataclass(frozen=True, slots=True)
class TimeMapping:
    """The table [time]: when each row was, and what to do where that is between two cycles."""

    column: str | None = None
    unit: Literal["s", "ms", "us", "ns"] | None = None
    format: str | None = None
    """Of a column of text, in the words of strptime."""
    rate_Hz: Annotated[float | None, Limits(1e-3, 1e6)] = None
    """Of rows without a time column."""
    grid: GridMode = "exact"
    share: Annotated[float, Limits(0.0, 0.5)] = 0.01
    """With grid exact: how far a row may be from its cycle, as a share of a cycle."""
    gap_s: Annotated[float, Limits(1e-3, 60.0)] = 1.0
    """With grids hold and linear: how long there may be no row."""
    sort: bool = False
    """Whether to put rows in the order of their times, which else is an error."""
    first_tick: int = 0
    """The cycle of the first row."""

    def __post_init__(self) -> None:
        """See that it is said in one way when a row was."""
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
    """The table [csv]: how a text table is written."""

    separator: str = ","
    decimal: Literal[".", ","] = "."

    def __post_init__(self) -> None:
        """See that columns can be told apart."""
        if len(self.separator) != 1 or not self.separator.isascii() or self.separator in '"\r\n':
            raise ValueError(
                f"csv: separator {self.separator!r} is not one character; write ',' or ';' or a tab"
            )
        if self.separator == self.decimal:
            raise ValueError(f"csv: separator and decimal are both {self.decimal!r}; one of them is another")


@dataclass(frozen=True, slots=True, eq=False)
class MappedChannel:
    """One field of a message, and where its values come from."""

    target: ChannelTarget
    columns: tuple[str, ...]
    """Empty if it is a constant."""
    constant: NDArray[Any] | str | None
    """As it goes into the log, or TICK."""
    conversion: Conversion
    gain: NDArray[np.float64]
    offset: NDArray[np.float64]
    line: int
    """Of the mapping."""


@dataclass(frozen=True, slots=True)
class TimedCommand:
    """A command, and the first cycle that sees it."""

    tick: int
    command: Command
    line: int
    """Of the mapping."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightStart:
    """What flight software began with, for a table that is to be replayed."""

    params: Params
    mode: Mode
    reference: Reference | None
    commands: tuple[TimedCommand, ...]
    """In order of their ticks."""


@dataclass(frozen=True, slots=True)
class SessionMapping:
    """The table [session]: what was done, for a diagnosis of the gap."""

    name: str
    block: str | None = None
    """The same in all repeats of a motion; the name if it is not said."""
    temperature_C: Annotated[float | None, Limits(-273.15, 1000.0)] = None
    """Of the air; that of the windings in the first row if it is not said."""


@dataclass(frozen=True, slots=True, eq=False)
class TableMapping:
    """A mapping without a problem."""

    file: str
    arm: str
    time: TimeMapping
    csv: CsvFormat
    channels: tuple[MappedChannel, ...]
    start: FlightStart | None
    session: SessionMapping | None
