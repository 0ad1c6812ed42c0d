"""Reader of tables from Parquet and CSV, column by column; it checks everything in the file."""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv, parquet, types

from marsarm.common.requests import describe_bad_table
from marsarm.telemetry.imports.files import BadImport
from marsarm.telemetry.imports.mapping import CsvFormat
from sim.scenario.records import did_you_mean

PARQUET_MAGIC: Final = b"PAR1"
PARQUET_SUFFIXES: Final = (".parquet", ".pq")
TEXT_SUFFIXES: Final = (".csv", ".tsv", ".txt")
MAX_CELLS: Final = 100_000_000
"""Limit of rows times columns: ten hours at 64 Hz of forty columns."""
MAX_NAMES_SHOWN: Final = 20
FOREIGN_MAGIC: Final = {
    b"PK\x03\x04": "a zip file, as spreadsheets are",
    b"\x89MCAP": "an MCAP log; read it with `marsarm log`",
    b"\x1f\x8b": "compressed; unpack it first",
    b"SQLite": "a database",
    b"\x89HDF": "an HDF5 file",
    b"\xff\xfe": "text in UTF-16",
    b"\xfe\xff": "text in UTF-16",
}
"""Descriptions of other formats, by their first bytes."""

FLAG_WORDS: Final = {"true": True, "false": False, "1": True, "0": False}


@dataclass(frozen=True, slots=True, eq=False)
class InputColumn:
    """Column of numbers, flags or names, and the rows in which it has a value."""

    name: str
    values: NDArray[Any]
    """Values as float64, int64 or bool, or indices into `words`, shape (n,); arbitrary where not `given`."""
    given: NDArray[np.bool_]
    """True in rows with a value, shape (n,)."""
    words: tuple[str, ...] = ()
    """Different names of a column of names."""


@dataclass(frozen=True, slots=True, eq=False)
class InputTable:
    """Mapped columns of a table."""

    file: str
    rows: int
    _arrays: dict[str, Any]
    _decimal: str
    _is_text: bool
    _order: NDArray[np.int64] | None = None
    """Row of the file of each row here, shape (n,); None for the same order."""

    def error_at(self, what: str, row: int | None = None, column: str | None = None) -> BadImport:
        """Return an error that names file, row and column; row 1 is the first below the header."""
        places = [] if row is None else [f"row {self.row_number(row)}"]
        places += [] if column is None else [f"column {column!r}"]
        return BadImport([": ".join([self.file, *([", ".join(places)] if places else []), what])])

    def row_number(self, row: int) -> int:
        """Return the number of a row in the file, from 1."""
        return int(row if self._order is None else self._order[row]) + 1

    def in_order_of(self, keys: NDArray[Any]) -> "InputTable":
        """Return the table with its rows sorted by keys, shape (n,)."""
        order = np.argsort(keys, kind="stable")
        arrays = {name: array.take(pa.array(order)) for name, array in self._arrays.items()}
        return replace(self, _arrays=arrays, _order=order)

    @property
    def rows_moved(self) -> int:
        """Number of sorted rows that do not directly follow their predecessor in the file."""
        return 0 if self._order is None else int(np.count_nonzero(np.diff(self._order) != 1))

    def numbers(self, name: str) -> InputColumn:
        """Return a column of numbers or flags.

        Raises:
            BadImport: the column has other values.
        """
        array = self._arrays[name]
        given = _valid_mask(array)
        if not self._is_text:
            return InputColumn(name, self._numbers(name, array), given)
        text = self._decimal_point(pc.utf8_trim_whitespace(array))
        for kind in (pa.int64(), pa.float64()):
            try:
                values = _fill_nulls(pc.cast(text, kind))
            except pa.ArrowInvalid:
                continue
            self._check_finite(name, values, text)
            return InputColumn(name, values, given)
        return InputColumn(name, self._flags(name, text), given)

    def names(self, name: str) -> InputColumn:
        """Return a column of names; numbers become their text."""
        array = self._arrays[name]
        if types.is_integer(array.type) or types.is_floating(array.type) or types.is_boolean(array.type):
            column = self.numbers(name)
            values, indices = np.unique(column.values, return_inverse=True)
            return InputColumn(name, indices, column.given, tuple(str(value) for value in values.tolist()))
        coded = array if types.is_dictionary(array.type) else array.dictionary_encode()
        words = tuple(str(word).strip() for word in coded.dictionary.to_pylist())
        return InputColumn(name, _fill_nulls(coded.indices), _valid_mask(array), words or ("",))

    def is_time(self, name: str) -> bool:
        """Return whether a column holds timestamps, which have their own unit."""
        return bool(types.is_timestamp(self._arrays[name].type))

    def times_ns(self, name: str, form: str | None) -> InputColumn:
        """Return a column of times in nanoseconds, from timestamps, or from text in a format of strptime."""
        array = self._arrays[name]
        given = _valid_mask(array)
        try:
            if types.is_dictionary(array.type):
                array = array.dictionary_decode()
            if form is not None:
                read = pc.strptime(pc.utf8_trim_whitespace(array), form, "us", error_is_null=True)
                bad = np.flatnonzero(given & ~_valid_mask(read))
                if bad.size:
                    row = int(bad[0])
                    raise self.error_at(
                        f"{array[row].as_py()!r:.60} is no time as {form!r} has it", row, name
                    )
                array = read
            return InputColumn(
                name, _fill_nulls(pc.cast(pc.cast(array, pa.timestamp("ns")), pa.int64())), given
            )
        except pa.ArrowException as error:
            raise self.error_at("is no time", column=name) from error

    def _check_finite(self, name: str, values: NDArray[Any], text: Any) -> None:
        """Refuse a number whose digits are too large for a float."""
        for row in np.flatnonzero(np.isinf(values)):
            word = text[int(row)].as_py()
            if any(letter.isdigit() for letter in word):
                raise self.error_at(f"{word!r:.60} is too large to be a number", int(row), name)

    def _decimal_point(self, text: Any) -> Any:
        return pc.replace_substring(text, self._decimal, ".") if self._decimal != "." else text

    def _numbers(self, name: str, array: Any) -> NDArray[Any]:
        kind = array.type
        if types.is_boolean(kind):
            return _fill_nulls(array)
        if not types.is_integer(kind) and not types.is_floating(kind):
            content = "text" if types.is_dictionary(kind) else kind
            raise self.error_at(f"holds {content}, not numbers or flags; map another column", column=name)
        try:
            return _fill_nulls(pc.cast(array, pa.int64() if types.is_integer(kind) else pa.float64()))
        except pa.ArrowInvalid as error:
            raise self.error_at("holds a number that is too large", column=name) from error

    def _flags(self, name: str, text: Any) -> NDArray[Any]:
        """Parse flags; the error names the first value that is neither a flag nor a number."""
        words = text.to_pylist()
        if all(word is None or word.lower() in FLAG_WORDS for word in words):
            return np.array([word is not None and FLAG_WORDS[word.lower()] for word in words], bool)
        row = next(k for k, word in enumerate(words) if word is not None and not _is_number(word))
        raise self.error_at(
            f"{words[row]!r:.60} is no number{_number_hint(words[row], self._decimal)}", row, name
        )


def read_table(
    data: bytes, file: str, names: Sequence[str], form: CsvFormat, cells: int = MAX_CELLS
) -> InputTable:
    """Read columns of a table.

    Args:
        data: Content of the file.
        file: Name of the file; its ending selects Parquet or CSV.
        names: Columns.
        cells: Limit of rows times columns.

    Raises:
        BadImport: the file is damaged or of another format, lacks a column, has no row, or is too large.
    """
    suffix = Path(file).suffix.lower()
    if suffix not in (*PARQUET_SUFFIXES, *TEXT_SUFFIXES):
        kinds = " or ".join((*PARQUET_SUFFIXES[:1], *TEXT_SUFFIXES))
        raise BadImport([f"{file}: is no table that is known by its name; it must end in {kinds}"])
    if not data:
        raise BadImport([f"{file}: is an empty file; give a table with names over its columns"])
    is_text = suffix in TEXT_SUFFIXES
    if is_text and data.startswith(PARQUET_MAGIC):
        raise BadImport([f"{file}: is Parquet; name it .parquet"])
    if not is_text and not data.startswith(PARQUET_MAGIC):
        raise BadImport([f"{file}: is {_foreign_format(data) or 'text'}, not Parquet"])
    if is_text and (foreign := _foreign_format(data)) is not None:
        raise BadImport([f"{file}: is {foreign}; give a table as text in UTF-8, or as Parquet"])
    try:
        arrays = (_from_text if is_text else _from_parquet)(data, file, names, form, cells)
    except BadImport:
        raise
    except MemoryError as error:
        raise BadImport([f"{file}: is too large for the memory; give it in parts"]) from error
    except Exception as error:  # a truncated file may fail in any decoder
        kind = "text in columns" if is_text else "Parquet"
        raise BadImport([f"{file}: {describe_bad_table(error, kind)}"]) from error
    rows = len(next(iter(arrays.values()))) if arrays else 0
    if rows == 0:
        raise BadImport([f"{file}: has no row; give a table with at least one"])
    return InputTable(file, rows, arrays, form.decimal, is_text)


def _from_parquet(data: bytes, file: str, names: Sequence[str], _: CsvFormat, cells: int) -> dict[str, Any]:
    with parquet.ParquetFile(io.BytesIO(data)) as source:
        schema, rows = source.schema_arrow, source.metadata.num_rows
    _check_names(file, names, schema.names)
    _check_size(file, rows, len(names), cells)
    kinds = {name: schema.field(name).type for name in names}
    nested = [name for name, kind in kinds.items() if types.is_nested(kind)]
    if nested:
        raise BadImport([f"{file}: column {nested[0]!r} holds lists; give each number a column of its own"])
    # A small file can repeat one name in a hundred million rows, so names stay dictionary-encoded.
    words = [name for name, kind in kinds.items() if types.is_string(kind) or types.is_large_string(kind)]
    source = parquet.ParquetFile(io.BytesIO(data), read_dictionary=words, page_checksum_verification=True)
    with source:
        table = source.read(columns=list(names), use_threads=False)
    if len(table) != rows:
        raise BadImport([f"{file}: says that it has {rows} rows, and has {len(table)}"])
    table.validate(full=True)
    return {name: table.column(name).combine_chunks() for name in names}


def _from_text(data: bytes, file: str, names: Sequence[str], form: CsvFormat, cells: int) -> dict[str, Any]:
    text = data.removeprefix(b"\xef\xbb\xbf")
    head = text.split(b"\n", 1)[0].rstrip(b"\r")
    _check_size(file, text.count(b"\n"), len(names), cells)
    present = _column_names(head, form.separator)
    _check_names(file, names, present, f"; its separator is {form.separator!r}" if len(present) == 1 else "")
    if not text[len(head) :].strip():
        return {}
    if text.endswith((b"\n\n", b"\n\r\n")):
        text = text.rstrip(b"\r\n")  # blank lines are rows without values, except at the end
    table = csv.read_csv(
        io.BytesIO(text),
        csv.ReadOptions(use_threads=False),
        csv.ParseOptions(delimiter=form.separator, newlines_in_values=False, ignore_empty_lines=False),
        csv.ConvertOptions(
            column_types=dict.fromkeys(names, pa.string()),
            include_columns=list(names),
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=True,
        ),
    )
    return {name: table.column(name).combine_chunks() for name in names}


def _column_names(line: bytes, separator: str) -> list[str]:
    import csv as standard_csv  # the name csv is pyarrow's here

    return next(standard_csv.reader([line.decode("utf-8")], delimiter=separator), [])


def _check_names(file: str, names: Sequence[str], present: list[str], hint: str = "") -> None:
    known = present[:MAX_NAMES_SHOWN] + (["..."] if len(present) > MAX_NAMES_SHOWN else [])
    problems = []
    for name in dict.fromkeys(names):
        if name not in present:
            near, _, _ = did_you_mean(name, present).rpartition("there are ")
            problems.append(f"{file}: there is no column {name!r}; {near}there are {', '.join(known)}{hint}")
        elif present.count(name) > 1:
            problems.append(
                f"{file}: there are {present.count(name)} columns {name!r}; give each its own name"
            )
    if problems:
        raise BadImport(problems)


def _check_size(file: str, rows: int, columns: int, cells: int) -> None:
    if rows < 0 or rows * max(columns, 1) > cells:
        raise BadImport(
            [f"{file}: {rows} rows of {columns} columns are more than {cells} numbers; give it in parts"]
        )


def _foreign_format(data: bytes) -> str | None:
    kind = next((text for magic, text in FOREIGN_MAGIC.items() if data.startswith(magic)), None)
    return kind or ("no text: there are bytes of zero in it" if b"\0" in data[: 1 << 16] else None)


def _valid_mask(array: Any) -> NDArray[np.bool_]:
    return np.asarray(array.is_valid().to_numpy(zero_copy_only=False), bool)


def _fill_nulls(array: Any) -> NDArray[Any]:
    """Return the values, 0 in rows without a value; NaN is a value."""
    full = pc.fill_null(array, False if types.is_boolean(array.type) else 0)
    values: NDArray[Any] = full.to_numpy(zero_copy_only=False)
    return values


def _is_number(word: str) -> bool:
    """Return whether Arrow reads a word as a number; unlike Python it refuses 1_000 and other digits."""
    try:
        pc.cast(pa.scalar(word), pa.float64())
    except pa.ArrowInvalid:
        return False
    return True


def _number_hint(word: str, decimal: str) -> str:
    if decimal == "." and re.fullmatch(r"[-+]?\d*,\d+", word):
        return '; write decimal = "," under [csv]'
    return "; write a number, true or false, or nothing"
