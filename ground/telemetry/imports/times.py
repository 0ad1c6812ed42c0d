"""In which cycle each row of a table was: its time column, held against the grid of 64 Hz."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from ground.telemetry.format import TICK_NS
from ground.telemetry.imports.mapping import MAX_TICK, UNIT_NS, TimeMapping
from ground.telemetry.imports.table import InputColumn, InputTable

Cycles = NDArray[np.float64]
Ticks = NDArray[np.int64]
CYCLE_ROUNDING: Final = 1e-9
"""Relative to a cycle: a row this little beside a cycle is in it."""
RATE_TOLERANCE: Final = 0.02
"""How close to 64 Hz another unit must bring a table to be worth a hint."""


@dataclass(frozen=True, slots=True, eq=False)
class RowSelection:
    """Which rows become the messages of a topic: row and, for linear, how far on towards the next row."""

    ticks: Ticks
    rows: NDArray[np.int64]
    """Of those that have a value."""
    share: Cycles | None
    """None where no value lies between two rows."""


def sort_by_time(table: InputTable, time: TimeMapping) -> InputTable:
    """The table with its rows in order of time, where the mapping asks for that."""
    if not time.sort or time.column is None:
        return table
    column, _ = _time_column(table, time, time.column)
    _check_given(table, column)
    return table.in_order_of(column.values)


def cycles_of(table: InputTable, time: TimeMapping) -> Cycles:
    """When each row was, in cycles since the first one, (n,); it only grows.

    Raises:
        BadImport: a row has no time, or one that is not after that of the row before.
    """
    if time.column is None:
        assert time.rate_Hz is not None
        return np.arange(table.rows, dtype=np.float64) * (CYCLE_HZ / time.rate_Hz)
    column, unit_ns = _time_column(table, time, time.column)
    _check_given(table, column)
    _check_growing(table, column, is_moment=time.unit is None)
    values = column.values
    if values.dtype == np.int64:
        if float(values[-1]) - float(values[0]) >= 2.0**62:
            raise table.wrong("the times span too much; is the unit right?", column=column.name)
        since = (values - values[0]).astype(np.float64)
    else:
        since = values - values[0]
    cycles: Cycles = since * unit_ns / TICK_NS
    if not cycles[-1] < MAX_TICK:
        raise table.wrong(
            f"the times span {cycles[-1] / CYCLE_HZ:.3g} s; is the unit right?", column=column.name
        )
    return cycles


def _time_column(table: InputTable, time: TimeMapping, name: str) -> tuple[InputColumn, int]:
    if time.format is not None or table.is_time(name):
        if time.unit is not None:
            raise table.wrong("holds times that know their unit; leave unit out", column=name)
        return table.moments_ns(name, time.format), 1
    if time.unit is None:
        raise table.wrong(
            'its unit is missing; write unit = "s", "ms", "us" or "ns" under [time]', column=name
        )
    column = table.numbers(name)
    if column.values.dtype == np.bool_:
        raise table.wrong("holds flags, not times; under [time] name the column that has them", column=name)
    return column, UNIT_NS[time.unit]


def _check_given(table: InputTable, column: InputColumn) -> None:
    """Refuse rows without a time."""
    values = column.values
    lacking = np.flatnonzero(~column.given)
    if lacking.size:
        raise table.wrong("has no time; every row needs one", int(lacking[0]), column.name)
    odd = np.flatnonzero(~np.isfinite(values))
    if odd.size:
        row = int(odd[0])
        raise table.wrong(f"the time is {values[row]}; every row needs one", row, column.name)


def _check_growing(table: InputTable, column: InputColumn, is_moment: bool) -> None:
    """Refuse a time that is not after that of the row before."""
    values = column.values
    late = np.flatnonzero(values[1:] <= values[:-1])
    if not late.size:
        return
    row = int(late[0]) + 1
    now, before = (np.datetime64(int(v), "ns") if is_moment else v for v in (values[row], values[row - 1]))
    other = table.row_number(row - 1)
    if now == before:
        what = f"time {now} is that of row {other} too; give each row its own, or rate_Hz instead of a column"
    else:
        what = f"time {now} is before {before} in row {other}; sort the table, or write sort = true in [time]"
    raise table.wrong(what, row, column.name)


def check_grid(table: InputTable, time: TimeMapping, cycles: Cycles) -> None:
    """With grid exact, refuse rows that are not one in each cycle.

    Raises:
        BadImport: with the words that would be right.
    """
    if time.grid != "exact":
        return
    ticks = np.rint(cycles)
    off = np.abs(cycles - ticks)
    skipped = np.diff(ticks) != 1
    bad = off[1:] > time.share
    if not bad.any() and not skipped.any():
        return
    row = int(np.flatnonzero(bad | skipped)[0]) + 1
    step = float(np.median(np.diff(cycles)))
    if abs(step - 1) > RATE_TOLERANCE:
        raise table.wrong(_describe_rate(time, step), column=time.column)
    if skipped[row - 1] and not bad[row - 1]:
        what = (
            f"{ticks[row] - ticks[row - 1]:.0f} cycles after the row before; under [time] write "
            'grid = "nearest" to leave the gap, or "hold" or "linear" to bridge it'
        )
    else:
        enough = min(0.5, float(off.max()) * 1.01)
        what = (
            f"is {off[row]:.3g} of a cycle beside the grid of {CYCLE_HZ} Hz, {time.share:g} is allowed; "
            f'under [time] write share = {enough:.2g}, or grid = "nearest", "hold" or "linear"'
        )
    raise table.wrong(what, row, time.column)


def _describe_rate(time: TimeMapping, step: float) -> str:
    """Rows that come at another rate: because of the unit, perhaps."""
    said = f"rows come at {CYCLE_HZ / step:.6g} Hz, the log has {CYCLE_HZ} Hz"
    if time.unit is not None:
        for unit, unit_ns in UNIT_NS.items():
            if abs(step * unit_ns / UNIT_NS[time.unit] - 1) < RATE_TOLERANCE:
                return f'{said}; with unit = "{unit}" they would come at {CYCLE_HZ} Hz'
    return (
        f'{said}; under [time] write grid = "linear" or "hold" to resample, or "nearest" to keep the rows as '
        "they are"
    )


def pick_rows(
    table: InputTable, time: TimeMapping, cycles: Cycles, rows: NDArray[np.int64], most: int
) -> RowSelection:
    """The messages, at most so many, of a topic that has values in these rows, (k,), k > 0.

    Raises:
        BadImport: two rows are in one cycle, or two are too far apart, or there would be too many.
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
            raise table.wrong(what, int(rows[k + 1]), time.column)
        return RowSelection(ticks + time.first_tick, np.arange(rows.size), None)
    return _resample(table, time, at, rows, most)


def _resample(
    table: InputTable, time: TimeMapping, at: Cycles, rows: NDArray[np.int64], most: int
) -> RowSelection:
    """A message in each cycle from the first row to the last."""
    wide = np.flatnonzero(np.diff(at) > time.gap_s * CYCLE_HZ * (1 + CYCLE_ROUNDING))
    if wide.size:
        k = int(wide[0])
        what = (
            f"{(at[k + 1] - at[k]) / CYCLE_HZ:.6g} s after the row before; grid {time.grid!r} bridges at "
            f'most gap_s = {time.gap_s:g}: set it, or write grid = "nearest"'
        )
        raise table.wrong(what, int(rows[k + 1]), time.column)
    first, last = np.ceil(at[0] - CYCLE_ROUNDING), np.floor(at[-1] + CYCLE_ROUNDING)
    if last - first >= most:
        raise table.wrong(f"spans {last - first + 1:.0f} cycles, more than {most}; give it in parts")
    if last < first:
        raise table.wrong("no cycle is between the first row and the last; give more rows")
    ticks = np.arange(int(first), int(last) + 1)
    below = np.clip(np.searchsorted(at, ticks + CYCLE_ROUNDING, side="right") - 1, 0, None)
    share = None
    if time.grid == "linear":
        above = np.minimum(below + 1, rows.size - 1)
        width = at[above] - at[below]
        share = np.divide(ticks - at[below], width, out=np.zeros(ticks.size), where=width > 0)
        share[share < CYCLE_ROUNDING] = 0.0
    return RowSelection(ticks + time.first_tick, below, share)


def interpolate(values: NDArray[Any], chosen: RowSelection) -> NDArray[Any]:
    """The values (k, ...) of the rows that have any, as those of the messages; flags and names are held."""
    low = values[chosen.rows]
    if chosen.share is None or values.dtype == np.bool_:
        return low
    inside = np.flatnonzero(chosen.share)
    rows = chosen.rows[inside]
    share = chosen.share[inside].reshape(-1, *(1,) * (values.ndim - 1))
    mix = _interpolate_counts if values.dtype == np.int64 else _interpolate_numbers
    made = low.copy()
    made[inside] = mix(values[rows], values[rows + 1], share)
    return made


def _interpolate_numbers(low: NDArray[Any], high: NDArray[Any], share: Cycles) -> NDArray[Any]:
    difference = high - low
    # A difference may be infinite though both are finite; their shares are not.
    stepped, shared = low + share * difference, (1 - share) * low + share * high
    made: NDArray[np.float64] = np.where(np.isfinite(difference), stepped, shared)
    return made


def _interpolate_counts(low: NDArray[Any], high: NDArray[Any], share: Cycles) -> NDArray[Any]:
    """Rounded; modulo 2**64, where the distance of any two counts is exact."""
    is_up = high >= low
    a, b = low.view(np.uint64), high.view(np.uint64)
    step = np.rint(share * np.where(is_up, b - a, a - b).astype(np.float64)).astype(np.uint64)
    made: NDArray[np.int64] = np.where(is_up, a + step, a - step).view(np.int64)
    return made
