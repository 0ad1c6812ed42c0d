"""Times of the rows of a table on the grid of 64 Hz: checks, selection of rows and interpolation."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.imports.mapping import MAX_TICK, UNIT_NS, TimeMapping
from marsarm.telemetry.imports.table import InputColumn, InputTable

Cycles = NDArray[np.float64]
Ticks = NDArray[np.int64]
CYCLE_ROUNDING: Final = 1e-9
"""Share of a cycle by which a row may miss a cycle and still belong to it."""
RATE_TOLERANCE: Final = 0.02
"""Relative distance from 64 Hz below which an error suggests another unit."""


@dataclass(frozen=True, slots=True, eq=False)
class RowSelection:
    """Rows that become the messages of a topic, each shape (m,)."""

    ticks: Ticks
    """Tick of each message."""
    rows: NDArray[np.int64]
    """Index of the row of each message, among the rows with a value."""
    fraction: Cycles | None
    """Fraction of the way to the next row, for grid "linear"; None without interpolation."""


def sort_by_time(table: InputTable, time: TimeMapping) -> InputTable:
    """Sort the rows of a table by time, if the mapping requests it."""
    if not time.sort or time.column is None:
        return table
    column, _ = _time_column(table, time, time.column)
    _check_given(table, column)
    return table.in_order_of(column.values)


def cycles_of(table: InputTable, time: TimeMapping) -> Cycles:
    """Convert the time of each row to cycles since the first row.

    Returns:
        Times in cycles, rising, shape (n,).

    Raises:
        BadImport: a row has no time, or its time is not after that of the row before.
    """
    if time.column is None:
        assert time.rate_Hz is not None
        return np.arange(table.rows, dtype=np.float64) * (CYCLE_HZ / time.rate_Hz)
    column, unit_ns = _time_column(table, time, time.column)
    _check_given(table, column)
    _check_rising(table, column, is_timestamp=time.unit is None)
    values = column.values
    if values.dtype == np.int64:
        if float(values[-1]) - float(values[0]) >= 2.0**62:
            raise table.error_at("the times span too much; is the unit right?", column=column.name)
        since = (values - values[0]).astype(np.float64)
    else:
        since = values - values[0]
    cycles: Cycles = since * unit_ns / TICK_NS
    if not cycles[-1] < MAX_TICK:
        raise table.error_at(
            f"the times span {cycles[-1] / CYCLE_HZ:.3g} s; is the unit right?", column=column.name
        )
    return cycles


def _time_column(table: InputTable, time: TimeMapping, name: str) -> tuple[InputColumn, int]:
    if time.format is not None or table.is_time(name):
        if time.unit is not None:
            raise table.error_at("holds times that know their unit; leave unit out", column=name)
        return table.times_ns(name, time.format), 1
    if time.unit is None:
        raise table.error_at(
            'its unit is missing; write unit = "s", "ms", "us" or "ns" under [time]', column=name
        )
    column = table.numbers(name)
    if column.values.dtype == np.bool_:
        raise table.error_at(
            "holds flags, not times; under [time] name the column that has them", column=name
        )
    return column, UNIT_NS[time.unit]


def _check_given(table: InputTable, column: InputColumn) -> None:
    """Refuse rows without a time."""
    values = column.values
    lacking = np.flatnonzero(~column.given)
    if lacking.size:
        raise table.error_at("has no time; every row needs one", int(lacking[0]), column.name)
    odd = np.flatnonzero(~np.isfinite(values))
    if odd.size:
        row = int(odd[0])
        raise table.error_at(f"the time is {values[row]}; every row needs one", row, column.name)


def _check_rising(table: InputTable, column: InputColumn, is_timestamp: bool) -> None:
    """Refuse a time that is not after that of the row before."""
    values = column.values
    late = np.flatnonzero(values[1:] <= values[:-1])
    if not late.size:
        return
    row = int(late[0]) + 1
    now, before = (np.datetime64(int(v), "ns") if is_timestamp else v for v in (values[row], values[row - 1]))
    other = table.row_number(row - 1)
    if now == before:
        what = f"time {now} is that of row {other} too; give each row its own, or rate_Hz instead of a column"
    else:
        what = f"time {now} is before {before} in row {other}; sort the table, or write sort = true in [time]"
    raise table.error_at(what, row, column.name)


def check_grid(table: InputTable, time: TimeMapping, cycles: Cycles) -> None:
    """Check that each cycle has one row, if the grid is "exact".

    Args:
        time: Table [time] of the mapping.
        cycles: Times in cycles, shape (n,).

    Raises:
        BadImport: a row is missing or not on the grid; the message says what to write under [time].
    """
    if time.grid != "exact":
        return
    ticks = np.rint(cycles)
    distance = np.abs(cycles - ticks)
    skipped = np.diff(ticks) != 1
    bad = distance[1:] > time.tolerance_cycles
    if not bad.any() and not skipped.any():
        return
    row = int(np.flatnonzero(bad | skipped)[0]) + 1
    step = float(np.median(np.diff(cycles)))
    if abs(step - 1) > RATE_TOLERANCE:
        raise table.error_at(_describe_rate(time, step), column=time.column)
    if skipped[row - 1] and not bad[row - 1]:
        what = (
            f"{ticks[row] - ticks[row - 1]:.0f} cycles after the row before; under [time] write "
            'grid = "nearest" to leave the gap, or "hold" or "linear" to bridge it'
        )
    else:
        enough = min(0.5, float(distance.max()) * 1.01)
        what = (
            f"is {distance[row]:.3g} of a cycle beside the grid of {CYCLE_HZ} Hz, "
            f"{time.tolerance_cycles:g} is allowed; "
            f'under [time] write tolerance_cycles = {enough:.2g}, or grid = "nearest", "hold" or "linear"'
        )
    raise table.error_at(what, row, time.column)


def _describe_rate(time: TimeMapping, step: float) -> str:
    """Describe rows at another rate than 64 Hz, and the remedy, which may be another unit."""
    finding = f"rows come at {CYCLE_HZ / step:.6g} Hz, the log has {CYCLE_HZ} Hz"
    if time.unit is not None:
        for unit, unit_ns in UNIT_NS.items():
            if abs(step * unit_ns / UNIT_NS[time.unit] - 1) < RATE_TOLERANCE:
                return f'{finding}; with unit = "{unit}" they would come at {CYCLE_HZ} Hz'
    return (
        f'{finding}; under [time] write grid = "linear" or "hold" to resample, '
        'or "nearest" to keep the rows as they are'
    )


def pick_rows(
    table: InputTable, time: TimeMapping, cycles: Cycles, rows: NDArray[np.int64], max_messages: int
) -> RowSelection:
    """Select the rows that become the messages of a topic.

    Args:
        time: Table [time] of the mapping.
        cycles: Times of all rows in cycles, shape (n,).
        rows: One or more rows with values, shape (k,).
        max_messages: Limit of the messages.

    Raises:
        BadImport: two rows are in one cycle or too far apart, or there are too many messages.
    """
    at = cycles[rows]
    if time.grid in ("exact", "nearest"):
        ticks = np.rint(at).astype(np.int64)
        twice = np.flatnonzero(np.diff(ticks) == 0)
        if twice.size:
            k = int(twice[0])
            before = table.row_number(int(rows[k]))
            what = (
                f"is in the same cycle as row {before}; a channel has one message a cycle: under [time] "
                'write grid = "hold" or "linear"'
            )
            raise table.error_at(what, int(rows[k + 1]), time.column)
        return RowSelection(ticks + time.first_tick, np.arange(rows.size), None)
    return _resample(table, time, at, rows, max_messages)


def _resample(
    table: InputTable, time: TimeMapping, at: Cycles, rows: NDArray[np.int64], max_messages: int
) -> RowSelection:
    """Select or interpolate a message for each cycle from the first row to the last."""
    wide = np.flatnonzero(np.diff(at) > time.max_interval_s * CYCLE_HZ * (1 + CYCLE_ROUNDING))
    if wide.size:
        k = int(wide[0])
        what = (
            f"{(at[k + 1] - at[k]) / CYCLE_HZ:.6g} s after the row before; grid {time.grid!r} bridges at "
            f'most max_interval_s = {time.max_interval_s:g}: set it, or write grid = "nearest"'
        )
        raise table.error_at(what, int(rows[k + 1]), time.column)
    first, last = np.ceil(at[0] - CYCLE_ROUNDING), np.floor(at[-1] + CYCLE_ROUNDING)
    if last - first >= max_messages:
        raise table.error_at(
            f"spans {last - first + 1:.0f} cycles, more than {max_messages}; give it in parts"
        )
    if last < first:
        raise table.error_at("no cycle is between the first row and the last; give more rows")
    ticks = np.arange(int(first), int(last) + 1)
    below = np.clip(np.searchsorted(at, ticks + CYCLE_ROUNDING, side="right") - 1, 0, None)
    fraction = None
    if time.grid == "linear":
        above = np.minimum(below + 1, rows.size - 1)
        width = at[above] - at[below]
        fraction = np.divide(ticks - at[below], width, out=np.zeros(ticks.size), where=width > 0)
        fraction[fraction < CYCLE_ROUNDING] = 0.0
    return RowSelection(ticks + time.first_tick, below, fraction)


def interpolate(values: NDArray[Any], chosen: RowSelection) -> NDArray[Any]:
    """Return the values of the messages; flags and names keep the value of the last row.

    Args:
        values: Values of the rows that have one, shape (k, ...).
        chosen: Rows of the m messages.

    Returns:
        Values, shape (m, ...).
    """
    low = values[chosen.rows]
    if chosen.fraction is None or values.dtype == np.bool_:
        return low
    inside = np.flatnonzero(chosen.fraction)
    rows = chosen.rows[inside]
    fraction = chosen.fraction[inside].reshape(-1, *(1,) * (values.ndim - 1))
    between = _interpolate_counts if values.dtype == np.int64 else _interpolate_numbers
    result = low.copy()
    result[inside] = between(values[rows], values[rows + 1], fraction)
    return result


def _interpolate_numbers(low: NDArray[Any], high: NDArray[Any], fraction: Cycles) -> NDArray[Any]:
    difference = high - low
    # The difference of two finite numbers may be infinite; a weighted mean is not.
    stepped, weighted = low + fraction * difference, (1 - fraction) * low + fraction * high
    result: NDArray[np.float64] = np.where(np.isfinite(difference), stepped, weighted)
    return result


def _interpolate_counts(low: NDArray[Any], high: NDArray[Any], fraction: Cycles) -> NDArray[Any]:
    """Interpolate and round counts modulo 2**64, where the difference of any two counts is exact."""
    is_up = high >= low
    a, b = low.view(np.uint64), high.view(np.uint64)
    step = np.rint(fraction * np.where(is_up, b - a, a - b).astype(np.float64)).astype(np.uint64)
    result: NDArray[np.int64] = np.where(is_up, a + step, a - step).view(np.int64)
    return result
