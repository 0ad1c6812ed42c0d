"""Tables in files of text: CSV with any separator, and JSON lines."""

import csv
import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.csv as pacsv

from simgap.common.console import pluralize
from simgap.common.errors import RobotError
from simgap.files.columns import missing_column
from simgap.files.robot_file import CsvTable
from simgap.files.table_log import TableLog, base_columns, check_size, open_table

MAX_BYTES: Final = (1 << 31) - 1
"""Largest size of a file of text, which is read as one block so that all rows decide the type of a column."""
SAMPLE_BYTES: Final = 1 << 20
N_SAMPLE: Final = 50
"""Rows by which the separator is found: a few suffice, but the first ones may have empty cells."""
FORMS: Final = (*((one, ".") for one in ",;\t| "), *((one, ",") for one in ";\t "))
"""Separators and decimal characters that are tried; of those that fit alike the first is taken."""
NUMBER: Final = re.compile(
    r"\s*[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|nan|inf)\s*", re.IGNORECASE
)
PLACE: Final = "column"
"""Name of the list that the columns of a table without a header form."""


@dataclass(frozen=True, slots=True)
class _Form:
    separator: str
    decimal: str
    header: list[str] | None
    """Names of the columns; None if the first row has numbers."""
    n_columns: int


def open_csv(path: Path, wanted: Sequence[str] | None, texts: Sequence[str], given: CsvTable) -> TableLog:
    """Open a CSV file; what the robot file does not say of its form is found by the first rows.

    A last row that is cut is left out, and the log tells it.

    Args:
        path: Path of the file.
        wanted: Columns to read; None for all.
        texts: Those of them that are read as text.
        given: Separator and decimal character, if the robot file says them.

    Raises:
        RobotError: it is no text, a column is missing, or a row has another number of cells.
    """
    check_size(path, 0 if path.stat().st_size <= MAX_BYTES else MAX_BYTES)
    data = path.read_bytes()
    form = _find_form(path, data, given, wanted)
    if form.separator == " ":  # aligned columns have several spaces
        data = b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    there = form.header or [f"{PLACE}[{k}]" for k in range(form.n_columns)]
    chosen = there if wanted is None else _exact(path, wanted, there)
    bad: list[pacsv.InvalidRow] = []

    def skip(row: pacsv.InvalidRow) -> str:
        bad.append(row)
        return "skip"

    table = pacsv.read_csv(
        pa.BufferReader(data.removeprefix(b"\xef\xbb\xbf")),
        read_options=pacsv.ReadOptions(
            use_threads=False,  # rows have their numbers only so
            block_size=max(len(data), 1),
            column_names=there,
            skip_rows=0 if form.header is None else 1,
        ),
        parse_options=pacsv.ParseOptions(delimiter=form.separator, invalid_row_handler=skip),
        convert_options=pacsv.ConvertOptions(
            column_types=dict.fromkeys((one for one in texts if one in chosen), pa.string()),
            include_columns=chosen,
            null_values=[""],
            decimal_point=form.decimal,
            strings_can_be_null=False,
        ),
    )
    losses = _judge_rows(path, data, bad, table.num_rows)
    return open_table(path, dict(zip(chosen, table.columns, strict=True)), wanted or (), losses=losses)


def _exact(path: Path, wanted: Sequence[str], there: Sequence[str]) -> list[str]:
    """Return the wanted columns: cells of text hold no lists, so that each name stands in the header."""
    for name in wanted:
        if name not in there:
            raise missing_column(path, name, there)
    return base_columns(path, wanted, there)


def _judge_rows(path: Path, data: bytes, bad: Sequence[pacsv.InvalidRow], n_rows: int) -> list[str]:
    """Tell of a last row that is cut; refuse any other row with the wrong number of cells."""
    if not bad:
        return []
    row, n_lines = bad[0], len(data.rstrip().splitlines())
    what = f"line {row.number} has {row.actual_columns} of {row.expected_columns} columns"
    if len(bad) > 1 or row.number != n_lines or row.actual_columns > row.expected_columns:
        raise RobotError(f"{path}: {what}; give each row all columns, or remove it")
    return [f"{what}, where the file was cut; the {pluralize(n_rows, 'row')} before it are used"]


def _find_form(path: Path, data: bytes, given: CsvTable, wanted: Sequence[str] | None) -> _Form:
    """Find separator, decimal character and header by the first rows: most cells are numbers."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise RobotError(f"{path}: line {line} is not text in UTF-8; save it as UTF-8") from error
    lines = data[:SAMPLE_BYTES].decode("utf-8", "ignore").removeprefix("\ufeff").splitlines()
    text = "\n".join(lines[: N_SAMPLE + 1])
    forms = [
        (separator, decimal)
        for separator, decimal in FORMS
        if given.separator in ("", separator) and given.decimal in ("", decimal)
    ] or [(given.separator or ("," if given.decimal != "," else ";"), given.decimal or ".")]
    try:
        tried = [(_rows(text, separator), separator, decimal) for separator, decimal in forms]
    except (csv.Error, TypeError) as error:
        raise RobotError(f"{path}: cannot be read as a table: {error}") from error
    rows, separator, decimal = max(tried, key=lambda one: _score(one[0], one[2], wanted))
    if not rows:
        raise RobotError(f"{path}: has no rows; name a log with samples")
    first = rows[0]
    is_header = not all(_is_number(cell, decimal) for cell in first) or _is_named(first, wanted)
    return _Form(separator, decimal, first if is_header else None, len(first))


def _rows(text: str, separator: str) -> list[list[str]]:
    if separator == " ":
        return [line.split() for line in text.splitlines() if line.strip()]
    return [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=separator) if row]


def _score(rows: Sequence[Sequence[str]], decimal: str, wanted: Sequence[str] | None) -> tuple[bool, int]:
    """Return whether the header has all wanted names, and the numbers in rows as long as the first."""
    if not rows:
        return False, 0
    body = [row for row in rows[1:] or rows if len(row) == len(rows[0])]
    has_names = bool(wanted) and set(wanted or ()) <= set(rows[0])
    return has_names, sum(_is_number(cell, decimal) for row in body for cell in row)


def _is_number(cell: str, decimal: str) -> bool:
    return NUMBER.fullmatch(cell if decimal == "." else cell.replace(",", ".", 1)) is not None


def _is_named(first: Sequence[str], wanted: Sequence[str] | None) -> bool:
    """Tell whether a row of numbers is a header: it has the wanted names, or counts 0, 1, 2 and so on."""
    if wanted is not None:
        return set(wanted) <= set(first)
    return list(first) == [str(k) for k in range(len(first))] and len(first) > 1


def open_json_lines(path: Path, wanted: Sequence[str] | None) -> TableLog:
    """Open a file with one JSON object a line; objects in it are records, lists are lists.

    A last line that is cut is left out, and the log tells it.

    Raises:
        RobotError: a line is no JSON object, a column is missing, or its values are of several kinds.
    """
    lines = path.read_bytes().rstrip().split(b"\n")
    rows: list[dict[str, Any]] = []
    losses = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            if number < len(lines) or not rows:
                raise RobotError(f"{path}: line {number} is no JSON: {error}") from error
            losses = [
                f"line {number} is cut, where the file ends; the {pluralize(len(rows), 'line')} before it "
                "are used"
            ]
            break
        if not isinstance(row, dict):
            raise RobotError(f"{path}: line {number} is no JSON object; write {{...}} in each line")
        rows.append(row)
    names = base_columns(path, wanted, list(dict.fromkeys(name for row in rows for name in row)))
    check_size(path, len(rows) * len(names))
    columns = {}
    for name in names:
        try:
            columns[name] = pa.array([row.get(name) for row in rows])
        except (pa.ArrowException, OverflowError) as error:
            raise RobotError(
                f"{path}: {name!r} has values of several kinds; give it numbers or texts alone"
            ) from error
    return open_table(path, columns, wanted or (), losses=losses)
