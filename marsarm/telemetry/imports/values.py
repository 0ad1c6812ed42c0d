"""Conversion of columns to the values of a channel: gain, offset, unit and type."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from marsarm.telemetry.imports.mapping import TICK, MappedChannel
from marsarm.telemetry.imports.table import InputColumn, InputTable
from sim.scenario.records import did_you_mean

INT64_LIMIT: Final = 2.0**63
MAX_EXACT_INT: Final = 1 << 53
"""Limit up to which every integer is exact as a float."""


def read_columns(table: InputTable, channel: MappedChannel) -> list[InputColumn]:
    """Read the columns of a channel.

    Raises:
        BadImport: a column has values that the channel cannot hold.
    """
    read = table.numbers if channel.target.members is None else table.names
    return [read(name) for name in channel.columns]


def channel_values(
    table: InputTable, channel: MappedChannel, columns: list[InputColumn], rows: NDArray[np.int64]
) -> NDArray[Any]:
    """Convert columns to the values of a channel.

    Args:
        table: Table, for messages.
        channel: Channel of the mapping.
        columns: Columns of the channel; none for a constant.
        rows: Rows to convert, shape (k,).

    Returns:
        Values in the type of the log, shape (k, *shape of the field).

    Raises:
        BadImport: the channel cannot hold a value.
    """
    shape = channel.target.field.shape or ()
    if not columns:
        return _constant_rows(channel, rows.size).reshape(rows.size, *shape)
    parts = [_convert(table, channel, column, k, rows) for k, column in enumerate(columns)]
    return np.stack(parts, axis=1).reshape(rows.size, *shape)


def _constant_rows(channel: MappedChannel, count: int) -> NDArray[Any]:
    """Repeat a constant for each message; the caller fills in the number of the cycle."""
    kind = np.dtype(channel.target.field.kind)
    if isinstance(channel.constant, str):
        assert channel.constant == TICK
        return np.zeros((count, 1), kind)
    value = channel.constant
    if kind.kind == "f":
        value = convert_to_si(channel, np.asarray(value, np.float64), slice(None))
    return np.broadcast_to(np.asarray(value, kind), (count, channel.target.size))


def _convert(
    table: InputTable, channel: MappedChannel, column: InputColumn, k: int, rows: NDArray[np.int64]
) -> NDArray[Any]:
    values = column.values[rows]
    if channel.target.members is not None:
        return _convert_names(table, channel, column, values, rows)
    match channel.target.field.kind:
        case "<f8":
            _check_exact(table, column, values, rows)
            return _convert_numbers(table, channel, column, values.astype(np.float64), k, rows)
        case "<i8":
            return _convert_counts(table, channel, column, values, k, rows)
        case _:
            return _convert_flags(table, channel, column, values, k, rows)


def convert_to_si(channel: MappedChannel, values: NDArray[np.float64], k: int | slice) -> NDArray[np.float64]:
    """Apply gain, offset and unit; a step that changes nothing is left out, so that every bit is kept.

    Args:
        channel: Channel of the mapping.
        values: Values of the table, shape (n,).
        k: Column, or all columns.

    Returns:
        Values in the unit of the log, shape (n,).
    """
    gain, offset, unit = channel.gain[k], channel.offset[k], channel.conversion
    if np.any(gain != 1.0):
        values = values * gain
    if np.any(offset != 0.0):
        values = values + offset
    if unit.factor != 1.0:
        values = values * unit.factor
    if unit.offset != 0.0:
        values = values + unit.offset
    return values


def _convert_numbers(
    table: InputTable,
    channel: MappedChannel,
    column: InputColumn,
    values: NDArray[np.float64],
    k: int,
    rows: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Convert numbers; refuse a finite number that becomes infinite or NaN."""
    converted = convert_to_si(channel, values, k)
    beyond = np.flatnonzero(np.isfinite(values) & ~np.isfinite(converted))
    if beyond.size:
        what = f"{values[beyond[0]]} is too large for its gain, offset and unit; are they right?"
        raise table.error_at(what, int(rows[beyond[0]]), column.name)
    return converted


def _check_exact(
    table: InputTable, column: InputColumn, values: NDArray[Any], rows: NDArray[np.int64]
) -> None:
    if values.dtype != np.int64:
        return
    large = np.flatnonzero((values > MAX_EXACT_INT) | (values < -MAX_EXACT_INT))
    if large.size:
        row = int(rows[large[0]])
        raise table.error_at(f"{values[large[0]]} is too large to be a number without loss", row, column.name)


def _convert_counts(
    table: InputTable,
    channel: MappedChannel,
    column: InputColumn,
    values: NDArray[Any],
    k: int,
    rows: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Convert counts; a result of gain or offset is rounded."""
    gain, offset = float(channel.gain[k]), float(channel.offset[k])
    if values.dtype == np.bool_:
        raise table.error_at(
            f"holds flags; {channel.target.name} is counted; map a column of whole numbers",
            column=column.name,
        )
    if values.dtype == np.int64 and _is_exact(gain) and _is_exact(offset):
        return _convert_counts_exactly(table, column, values, (int(gain), int(offset)), rows)
    _check_exact(table, column, values, rows)
    numbers = convert_to_si(channel, values.astype(np.float64), k)
    good = np.isfinite(numbers)
    if (gain, offset) == (1.0, 0.0):
        good &= numbers == np.rint(numbers)
    if not good.all():
        row = int(np.flatnonzero(~good)[0])
        what = f"{numbers[row]} is no whole number, which {channel.target.name} takes"
        raise table.error_at(what, int(rows[row]), column.name)
    large = np.flatnonzero(np.abs(numbers) > MAX_EXACT_INT)
    if large.size:
        row = int(large[0])
        what = f"{numbers[row]:.17g} is too large to be counted without loss; give whole numbers, and no gain"
        raise table.error_at(what, int(rows[row]), column.name)
    return np.rint(numbers).astype(np.int64)


def _is_exact(number: float) -> bool:
    return number.is_integer() and abs(number) <= MAX_EXACT_INT


def _convert_counts_exactly(
    table: InputTable,
    column: InputColumn,
    values: NDArray[np.int64],
    gain_and_offset: tuple[int, int],
    rows: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Compute gain * value + offset in integers; a result that overflows 64 bits is far from its float."""
    gain, offset = gain_and_offset
    converted = values * np.int64(gain) + np.int64(offset)
    approximate = values.astype(np.float64) * gain + offset
    beyond = np.flatnonzero(np.abs(converted.astype(np.float64) - approximate) > INT64_LIMIT / 2)
    if beyond.size:
        what = f"{values[beyond[0]]} with its gain and offset has more than 64 bits; are they right?"
        raise table.error_at(what, int(rows[beyond[0]]), column.name)
    return converted


def _convert_flags(
    table: InputTable,
    channel: MappedChannel,
    column: InputColumn,
    values: NDArray[Any],
    k: int,
    rows: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Convert flags from true and false, or 1 and 0; a gain of -1 and an offset of 1 invert them."""
    is_scaled = channel.gain[k] != 1.0 or channel.offset[k] != 0.0
    if values.dtype == np.bool_ and not is_scaled:
        return values
    _check_exact(table, column, values, rows)
    numbers: NDArray[np.float64] = convert_to_si(channel, values.astype(np.float64), k)
    odd = np.flatnonzero((numbers != 0.0) & (numbers != 1.0))
    if odd.size:
        what = f"{numbers[odd[0]]} is neither true nor false, 1 nor 0, which {channel.target.name} takes"
        raise table.error_at(what, int(rows[odd[0]]), column.name)
    return np.equal(numbers, 1.0)


def _convert_names(
    table: InputTable,
    channel: MappedChannel,
    column: InputColumn,
    values: NDArray[Any],
    rows: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Convert names or numbers of members of an enumeration to their values."""
    members = channel.target.members
    assert members is not None
    by_number = {str(value): value for value in members.values()}
    known = [by_number.get(word, channel.target.member(word)) for word in column.words]
    codes = np.array([-1 if number is None else number for number in known], np.int64)
    found: NDArray[np.int64] = codes[values]
    unknown = np.flatnonzero(found < 0)
    if unknown.size:
        word = column.words[values[unknown[0]]]
        hint = did_you_mean(word[:60], members)
        raise table.error_at(f"{word!r:.60} is not known; {hint}", int(rows[unknown[0]]), column.name)
    return found
