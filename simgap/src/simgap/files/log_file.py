"""Log files as columns; `FORMATS` has the suffixes, and `open_log` chooses by them."""

import csv
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simgap.common.errors import RobotError
from simgap.files.columns import Column, LogFile, check_columns
from simgap.files.mcap_log import open_mcap
from simgap.files.robot_file import CsvTable

MAX_VALUES: Final = 100_000_000
"""Largest number of values that are read: a small file can claim any number of rows."""
MAX_BYTES: Final = 1 << 32
"""Largest size of a file of text."""


def open_log(path: Path, numbers: Sequence[str], texts: Sequence[str], csv_table: CsvTable) -> LogFile:
    """Open a log by its suffix.

    Raises:
        RobotError: the file cannot be read, has no such column, or has no rows.
    """
    if not os.path.isfile(path):  # unlike Path.is_file, False for any bad name
        if os.path.exists(path):
            raise RobotError(f"{path}: is no regular file; name a log")
        raise RobotError(f"{path}: there is no such log; name a file that exists")
    if path.stat().st_size == 0:
        raise RobotError(f"{path}: is an empty file; name a log with samples")
    opener = FORMATS.get(path.suffix.lower())
    if opener is None:
        raise RobotError(
            f"{path}: is no log by its suffix; name a file that ends in one of {', '.join(FORMATS)}"
        )
    try:
        return opener(path, numbers, texts, csv_table)
    except (OSError, OverflowError, ValueError, pa.ArrowException, zipfile.BadZipFile) as error:
        raise RobotError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    except MemoryError as error:
        raise RobotError(f"{path}: is too large for the memory; give it in parts") from error


@dataclass(frozen=True, slots=True)
class TableLog:
    """Table whose columns have one length."""

    path: Path
    table: pa.Table

    def numbers(self, name: str) -> Column:
        """Return the numbers of a column, timestamps in seconds; an empty cell is no number and no error."""
        column = self.table[name].combine_chunks()
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.uint8())
        if pa.types.is_timestamp(column.type):
            microseconds = column.cast(pa.timestamp("us"), safe=False).cast(pa.int64())
            column = pc.divide(microseconds.cast(pa.float64(), safe=False), 1e6)
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            raise RobotError(f"{self.path}: column {name!r} {_content(column)}; a signal needs numbers")
        is_present = column.is_valid().to_numpy(zero_copy_only=False) if column.null_count else None
        return Column(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), is_present)

    def texts(self, name: str) -> NDArray[np.str_]:
        """Return a column as text."""
        column = self.table[name]
        try:
            text = column.cast(pa.string())
        except pa.ArrowException as error:
            raise RobotError(
                f"{self.path}: column {name!r} has the type {column.type}; give it texts or numbers"
            ) from error
        return np.asarray(pc.fill_null(text, "").to_numpy(), dtype=np.str_)


@dataclass(frozen=True, slots=True)
class ArrayLog:
    """Arrays of one dimension by name, each of its own length."""

    path: Path
    arrays: Mapping[str, NDArray[Any]]

    def numbers(self, name: str) -> Column:
        """Return the numbers of an array."""
        array = self.arrays[name]
        if array.ndim != 1 or array.dtype.kind not in "fiub":
            raise RobotError(
                f"{self.path}: array {name!r} is {array.dtype} of shape {array.shape}; a signal needs "
                "numbers in one dimension"
            )
        return Column(array.astype(np.float64))

    def texts(self, name: str) -> NDArray[np.str_]:
        """Return an array as text."""
        array = self.arrays[name]
        if array.ndim != 1 or array.dtype.kind not in "fiubSU":
            raise RobotError(
                f"{self.path}: array {name!r} is {array.dtype} of shape {array.shape}; give it "
                "texts or numbers in one dimension"
            )
        return np.char.decode(array, "utf-8", "replace") if array.dtype.kind == "S" else array.astype(np.str_)


def _content(column: pa.Array) -> str:
    """Return what a column has in place of numbers."""
    if pa.types.is_null(column.type):
        return "is empty"
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


def _open_parquet(path: Path, wanted: Sequence[str]) -> TableLog:
    check_columns(path, wanted, pq.read_schema(path).names)
    _check_size(path, pq.read_metadata(path).num_rows * len(wanted))
    return TableLog(path, _not_empty(path, pq.read_table(path, columns=list(dict.fromkeys(wanted)))))


def _open_csv(path: Path, numbers: Sequence[str], texts: Sequence[str], form: CsvTable) -> TableLog:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            there = next(csv.reader(file, delimiter=form.separator), [])
    except UnicodeDecodeError as error:
        raise RobotError(f"{path}: is not text in UTF-8; save it as UTF-8") from error
    except (csv.Error, TypeError) as error:
        raise RobotError(f"{path}: cannot be read as a table: {error}") from error
    check_columns(path, [*numbers, *texts], there)
    _check_size(path, 0 if path.stat().st_size <= MAX_BYTES else MAX_VALUES + 1)
    convert = pacsv.ConvertOptions(
        column_types=dict.fromkeys((one for one in texts if one not in numbers), pa.string()),
        include_columns=list(dict.fromkeys([*numbers, *texts])),
        null_values=[""],
        decimal_point=form.decimal,
        strings_can_be_null=False,
    )
    parse = pacsv.ParseOptions(delimiter=form.separator)
    return TableLog(
        path, _not_empty(path, pacsv.read_csv(path, parse_options=parse, convert_options=convert))
    )


def _open_npz(path: Path, wanted: Sequence[str]) -> ArrayLog:
    if not zipfile.is_zipfile(path):  # numpy would take it for another format
        raise RobotError(f"{path}: is no NumPy .npz file, or is damaged; name another")
    try:
        with np.load(path, allow_pickle=False) as archive:
            check_columns(path, wanted, archive.files)
            arrays = {name: archive[name] for name in dict.fromkeys(wanted)}
    except (ValueError, EOFError, zlib.error) as error:
        raise RobotError(f"{path}: cannot be read: {error}") from error
    if any(array.size == 0 for array in arrays.values()):
        raise RobotError(f"{path}: has no rows; name a log with samples")
    return ArrayLog(path, arrays)


def _check_size(path: Path, n_values: int) -> None:
    if n_values > MAX_VALUES:
        raise RobotError(f"{path}: has more than {MAX_VALUES} values; give it in parts")


def _not_empty(path: Path, table: pa.Table) -> pa.Table:
    if table.num_rows == 0:
        raise RobotError(f"{path}: has no rows; name a log with samples")
    return table


FORMATS: Final[dict[str, Callable[[Path, Sequence[str], Sequence[str], CsvTable], LogFile]]] = {
    ".parquet": lambda path, numbers, texts, _: _open_parquet(path, [*numbers, *texts]),
    **dict.fromkeys((".csv", ".tsv", ".txt"), _open_csv),
    ".npz": lambda path, numbers, texts, _: _open_npz(path, [*numbers, *texts]),
    ".mcap": lambda path, numbers, *_: open_mcap(path, numbers),
}
"""Functions that open a log of each suffix for these numbers and texts."""
