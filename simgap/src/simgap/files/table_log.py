"""Logs that are tables: columns of numbers, texts, lists and records, each with one cell a row."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.columns import (
    MAX_LISTED,
    Column,
    ColumnInfo,
    Kind,
    describe_numbers,
    median_rate_Hz,
    missing_column,
    place_in_list,
    split_name,
)

MAX_VALUES: Final = 100_000_000
"""Largest number of values that are read: a small file can claim any number of rows."""


@dataclass(frozen=True, slots=True)
class TableLog:
    """Table; the columns of an npz file may differ in length."""

    path: Path
    columns: Mapping[str, pa.Array]
    """Columns that were read, by name."""
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Names of the items, for columns of lists where the file knows them."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units, for columns where the file knows them."""
    losses: Sequence[str] = ()
    """Sentences about parts of the file that could not be read; empty if all of it was."""
    time_column: str = ""
    """Column of the times, in seconds, unless the robot file names one; empty: none is known."""
    motion_column: str = ""
    """Column that names the motions, unless the robot file names one; empty: none is known."""

    def numbers(self, name: str) -> Column:
        """Return the numbers of a column, timestamps in seconds; an empty cell is no number and no error."""
        return self._numbers(name, self._column(name))

    def _numbers(self, name: str, column: pa.Array) -> Column:
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.uint8())
        if pa.types.is_timestamp(column.type):
            microseconds = column.cast(pa.timestamp("us"), safe=False).cast(pa.int64())
            column = pc.divide(microseconds.cast(pa.float64(), safe=False), 1e6)
        kind = column.type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or kind == pa.null()):
            raise RobotError(f"{self.path}: column {name!r} {_content(column)}; a signal needs numbers")
        is_present = column.is_valid().to_numpy(zero_copy_only=False) if column.null_count else None
        return Column(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), is_present)

    def texts(self, name: str) -> NDArray[np.str_]:
        """Return a column as text."""
        column = self._column(name)
        try:
            text = pc.fill_null(column.cast(pa.string()), "").to_numpy(zero_copy_only=False)
        except pa.ArrowException as error:
            is_text = pa.types.is_string(column.type)
            there = "has bytes that are no UTF-8" if is_text else _content(column)
            raise RobotError(f"{self.path}: column {name!r} {there}; give it texts or numbers") from error
        return np.asarray(text, dtype=np.str_)

    def describe(self, time_s: Array | None = None) -> tuple[ColumnInfo, ...]:
        """Describe all columns, also items of lists and fields of records; rates by times (n,) if given."""
        if self.time_column:
            time_s = self.numbers(self.time_column).value
        found = []
        for base, whole in self.columns.items():
            for name, column in expand(base, whole, self.names.get(base)):
                kind = _kind(column.type)
                unit = self.units.get(base, "")
                rate_Hz = _rate_Hz(column, time_s)
                if kind in ("number", "flag", "time"):
                    found.append(describe_numbers(name, self._numbers(name, column), kind, unit, rate_Hz))
                else:
                    found.append(ColumnInfo(name, kind, len(column) - column.null_count, rate_Hz))
        return tuple(found)

    def _column(self, name: str) -> pa.Array:
        """Return a column, an item of its lists, or a field of its records."""
        place = split_name(name, self.columns)
        if place is None:
            raise missing_column(self.path, name, list(self.columns))
        base, steps = place
        column, names = self.columns[base], self.names.get(base)
        for step in steps:
            taken = _take(column, step, names)
            if taken is None:
                there = [one for one, _ in expand(base, self.columns[base], self.names.get(base))]
                raise missing_column(self.path, name, there)
            column, names = taken, None
        return column


def open_table(
    path: Path, columns: Mapping[str, pa.Array | pa.ChunkedArray], wanted: Sequence[str], **known: Any
) -> TableLog:
    """Make a log of columns and other fields; RobotError if a wanted one is missing, or one has no rows."""
    is_chunked = {name: isinstance(one, pa.ChunkedArray) for name, one in columns.items()}
    arrays = {name: one.combine_chunks() if is_chunked[name] else one for name, one in columns.items()}
    if not arrays or any(len(one) == 0 for one in arrays.values()):
        raise RobotError(f"{path}: has no rows; name a log with samples")
    log = TableLog(path, arrays, **known)
    for name in wanted:
        log._column(name)
    return log


def base_columns(path: Path, wanted: Sequence[str] | None, there: Sequence[str]) -> list[str]:
    """Return the columns that hold the wanted ones, None for all; RobotError for none or several."""
    if wanted is None:
        return list(dict.fromkeys(there))
    found: dict[str, None] = {}
    for name in wanted:
        place = split_name(name, there)
        if place is None:
            raise missing_column(path, name, there)
        if there.count(place[0]) > 1:
            raise RobotError(
                f"{path}: has {there.count(place[0])} columns {place[0]!r}; give each its own name"
            )
        found[place[0]] = None
    return list(found)


def check_size(path: Path, n_values: int) -> None:
    """Refuse a table that is too large to be read at once."""
    if n_values > MAX_VALUES:
        raise RobotError(f"{path}: has more than {MAX_VALUES} values; give it in parts")


def expand(name: str, column: pa.Array, names: Sequence[str] | None) -> Iterator[tuple[str, pa.Array]]:
    """Yield the columns of numbers and texts in a column, which may be of lists or records."""
    if pa.types.is_struct(column.type):
        for one in column.type:
            yield from expand(f"{name}.{one.name}", pc.struct_field(column, one.name), None)
    elif 0 < (n := _shortest(column)) <= MAX_LISTED:
        for k in range(n):
            place = names[k] if names is not None and len(names) == n else k
            yield from expand(f"{name}[{place}]", pc.list_element(column, k), None)
    else:
        yield name, column


def _rate_Hz(column: pa.Array, time_s: Array | None) -> float | None:
    """Return the rate of the cells that have a value; None for a column with other rows than the times."""
    if time_s is None or len(column) != time_s.size:
        return None
    return median_rate_Hz(time_s[column.is_valid().to_numpy(zero_copy_only=False)])


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def _shortest(column: pa.Array) -> int:
    """Return the length of the shortest list of a column; 0 for a column of something else."""
    return (pc.min(pc.list_value_length(column)).as_py() or 0) if _is_list(column.type) else 0


def _take(column: pa.Array, step: str, names: Sequence[str] | None) -> pa.Array | None:
    """Return a field of records, or an item of lists; None if there is none."""
    if step.startswith("."):
        is_there = pa.types.is_struct(column.type) and column.type.get_field_index(step[1:]) >= 0
        return pc.struct_field(column, step[1:]) if is_there else None
    index = place_in_list(step, names)
    if index is None or not _is_list(column.type):
        return None
    try:
        return pc.list_element(column, index)
    except pa.ArrowInvalid:  # a list is not so long
        return None


def _kind(kind: pa.DataType) -> Kind:
    if pa.types.is_boolean(kind):
        return "flag"
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return "number"
    if pa.types.is_timestamp(kind):
        return "time"
    return "text" if pa.types.is_string(kind) or pa.types.is_large_string(kind) else "other"


def _content(column: pa.Array) -> str:
    """Return what a column has in place of numbers."""
    if _is_list(column.type):
        return f"has lists of {_shortest(column)}: write the place of an item, such as [0]"
    if not pa.types.is_string(column.type):
        return f"has the type {column.type}"
    row = next((k for k, one in enumerate(column) if one.is_valid and not _is_number(one.as_py())), 0)
    return f"has {column[row].as_py()!r} in row {row + 1}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
