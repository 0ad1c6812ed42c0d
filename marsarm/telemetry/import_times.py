"""Times of the rows of a table on the grid of 64 Hz: checks, selection of rows and interpolation."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from marsarm.telemetry.import_mapping import MAX_TICK, GridTime
from simgap.common.errors import RobotError
from simgap.files.columns import Column
from simgap.files.log_file import LogFile, read_times
from simgap.units import UNITS

CYCLE_ROUNDING: Final = 1e-4
"""Share of a cycle by which a row may miss a cycle and still belong to it; stamps of today have 1e-5."""
MAX_MESSAGES: Final = 100_000_000
Rows = NDArray[np.int64]
Cycles = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RowTimes:
    """Rows of a table in order of time."""

    path: Path
    column: str
    """Name of the time column, for messages; empty without one."""
    order: Rows
    """Row of the file of each row here, shape (n,)."""
    cycles: Cycles
    """Cycles since the first row, rising, shape (n,)."""

    def error_at(self, what: str, row: int | None = None, column: str = "") -> RobotError:
        """Return an error that names file, row and column; row 1 is the first below the header."""
        places = [] if row is None else [f"row {self.order[row] + 1}"]
        places += [f"column {column or self.column!r}"] if column or self.column else []
        return RobotError(": ".join([str(self.path), *([", ".join(places)] if places else []), what]))


@dataclass(frozen=True, slots=True, eq=False)
class RowSelection:
    """Rows that become the messages of a topic, each shape (m,)."""

    ticks: Rows
    rows: Rows
    """Index of the row of each message, among the rows with a value."""
    fraction: Cycles | None
    """Fraction of the way to the next row, for grid "linear"; None without interpolation."""


def row_times(log: LogFile, time: GridTime, column: Column) -> RowTimes:
    """Return the times of the rows of a column; RobotError if one is missing or not after the row before."""
    time_s = _times_s(log, time, column)
    if time_s.size != column.value.size:
        raise RobotError(
            f"{log.path}: has {column.value.size} values and {time_s.size} times; give one for each"
        )
    order = np.argsort(time_s, kind="stable") if time.sort else np.arange(time_s.size)
    time_s = time_s[order]
    times = RowTimes(log.path, time.column, order, (time_s - time_s[0]) * CYCLE_HZ)
    if not np.abs(times.cycles).max() < MAX_TICK:
        raise times.error_at(f"the times reach {np.abs(time_s).max():.3g} s; is the unit right?")
    late = np.flatnonzero(np.diff(times.cycles) <= 0)
    if late.size:
        k = int(late[0])
        raise times.error_at(
            f"its time is not after that of row {order[k] + 1}; give each row its own, and write sort = true "
            "in [time] if they are out of order",
            k + 1,
        )
    return times


def _times_s(log: LogFile, time: GridTime, column: Column) -> Cycles:
    if time.rate_Hz is not None:
        return np.arange(column.value.size) / time.rate_Hz
    if not time.column:
        if column.time_s is None:
            raise RobotError(f"{log.path}: has no times of its own; name its time column in time.column")
        return column.time_s
    factor = 1.0 if time.format else UNITS[time.unit].factor
    return read_times(log, time.column, time.format) * factor


def check_grid(times: RowTimes, time: GridTime) -> None:
    """Check that each cycle of an "exact" grid has one row; RobotError says what to write under [time]."""
    if time.grid != "exact":
        return
    ticks = np.rint(times.cycles)
    wrong = np.diff(ticks) != 1
    wrong |= np.abs(times.cycles - ticks)[1:] > time.tolerance_cycles
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        raise times.error_at(
            f"{times.cycles[row] - times.cycles[row - 1]:.6g} cycles of {CYCLE_HZ} Hz after the row before, "
            f"{times.cycles[row]:.6g} after the first; if the unit is right, write under [time] "
            'grid = "nearest" to keep the rows as they are, "hold" or "linear" to resample them, or a larger '
            "tolerance_cycles",
            row,
        )


def pick_rows(times: RowTimes, time: GridTime, rows: Rows) -> RowSelection:
    """Select messages of a topic from rows with values, (k,); RobotError for two in one cycle or too many."""
    at = times.cycles[rows]
    if time.grid in ("exact", "nearest"):
        ticks = np.rint(at).astype(np.int64)
        twice = np.flatnonzero(np.diff(ticks) == 0)
        if twice.size:
            raise times.error_at(
                "is in the same cycle as the row before; a channel has one message a cycle: under [time] "
                'write grid = "hold" or "linear"',
                int(rows[twice[0] + 1]),
            )
        return RowSelection(ticks + time.first_tick, np.arange(rows.size), None)
    wide = np.flatnonzero(np.diff(at) > time.max_interval_s * CYCLE_HZ + CYCLE_ROUNDING)
    if wide.size:
        k = int(wide[0])
        raise times.error_at(
            f"{(at[k + 1] - at[k]) / CYCLE_HZ:.6g} s after the row before; grid {time.grid!r} bridges at "
            f'most max_interval_s = {time.max_interval_s:g}: set it, or write grid = "nearest"',
            int(rows[k + 1]),
        )
    first, last = np.ceil(at[0] - CYCLE_ROUNDING), np.floor(at[-1] + CYCLE_ROUNDING)
    if not 0 <= last - first < MAX_MESSAGES:
        raise times.error_at(f"its rows span {last - first + 1:.0f} cycles; give it in parts, or more rows")
    ticks = np.arange(int(first), int(last) + 1)
    below = np.clip(np.searchsorted(at, ticks + CYCLE_ROUNDING, side="right") - 1, 0, None)
    fraction = None
    if time.grid == "linear":
        above = np.minimum(below + 1, rows.size - 1)
        width = at[above] - at[below]
        fraction = np.divide(ticks - at[below], width, out=np.zeros(ticks.size), where=width > 0)
        fraction[np.abs(ticks - at[below]) < CYCLE_ROUNDING] = 0.0
    return RowSelection(ticks + time.first_tick, below, fraction)


def interpolate(values: NDArray[Any], chosen: RowSelection) -> NDArray[Any]:
    """Interpolate values of rows, (k, ...), to messages, (m, ...); flags keep that of the last row."""
    found = values[chosen.rows]
    if chosen.fraction is None or values.dtype == np.bool_:
        return found
    inside = np.flatnonzero(chosen.fraction)
    rows = chosen.rows[inside]
    fraction = chosen.fraction[inside].reshape(-1, *(1,) * (values.ndim - 1))
    # Not low + fraction * (high - low): the difference of two finite numbers may be infinite.
    between = (1 - fraction) * values[rows] + fraction * values[rows + 1]
    found[inside] = np.rint(between) if values.dtype.kind == "i" else between
    return found
