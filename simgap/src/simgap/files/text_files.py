"""Tables in files of text: CSV with any separator, and JSON lines."""

import csv
import gzip
import io
import json
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
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


NO_NUMBERS: Final = ("", "nan", "NaN", "NAN", "-nan")
"""Cells without a number: numpy and pandas write NaN where others leave a cell empty."""
CLOCK: Final = r"^(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:[.,]\d+)?)$"
"""Time of day."""
Row = tuple[int, list[str]]
"""Lines of the file up to the end of a row, and its cells."""


@dataclass(frozen=True, slots=True)
class _Form:
    separator: str
    decimal: str
    header: list[str] | None
    """Names of the columns; None if there are none."""
    n_columns: int
    n_head: int
    """Lines before the first row of numbers."""
    n_left_out: int
    """Rows among them that are not the header."""


def read_whole(path: Path) -> bytes:
    """Read a file of text, which may be packed by gzip; RobotError if it is too large, or damaged."""
    check_size(path, 0 if path.stat().st_size <= MAX_BYTES else MAX_BYTES)
    if path.suffix.lower() != ".gz":
        return path.read_bytes()
    try:
        with gzip.open(path) as file:
            data = file.read(MAX_BYTES + 1)
    except (EOFError, zlib.error) as error:
        raise RobotError(f"{path}: cannot be read: {error}") from error
    check_size(path, 0 if len(data) <= MAX_BYTES else MAX_BYTES)
    return data


def open_csv(path: Path, wanted: Sequence[str] | None, texts: Sequence[str], given: CsvTable) -> TableLog:
    """Open a CSV file; what the robot file does not say of its form is found by the first rows.

    Lines without numbers before the rows, beside the header, are left out, and so is a last row that is cut;
    the log tells both.

    Raises:
        RobotError: it is no text, a column is missing, or a row has another number of cells.
    """
    data = read_whole(path)
    form = _find_form(path, data, given, wanted)
    if form.separator == " ":  # aligned columns have several spaces
        data = b"\n".join(b" ".join(line.split()) for line in data.splitlines())
    there = [name or f"{PLACE}[{k}]" for k, name in enumerate(form.header or [""] * form.n_columns)]
    chosen = base_columns(path, None, there) if wanted is None else _exact(path, wanted, there)
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
            skip_rows=form.n_head,
        ),
        parse_options=pacsv.ParseOptions(delimiter=form.separator, invalid_row_handler=skip),
        convert_options=pacsv.ConvertOptions(
            column_types=dict.fromkeys((one for one in texts if one in chosen), pa.string()),
            include_columns=chosen,
            null_values=NO_NUMBERS,
            decimal_point=form.decimal,
            strings_can_be_null=False,
        ),
    )
    losses = [*_tell_head(form, there), *_judge_rows(path, data, bad, table.num_rows)]
    columns = {
        name: column if name in texts else _seconds_of_day(column)
        for name, column in zip(chosen, table.columns, strict=True)
    }
    return open_table(path, columns, wanted or (), losses=losses)


def _seconds_of_day(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return times of day in seconds; any other column as it is."""
    if not (pa.types.is_string(column.type) or pa.types.is_time(column.type)):
        return column
    parts = pc.extract_regex(column.cast(pa.string()), CLOCK)
    if parts.null_count > column.null_count or parts.null_count == len(column):
        return column
    parts = [pc.struct_field(parts, k) for k in range(3)]
    hours, minutes, seconds = (pc.replace_substring(one, ",", ".").cast(pa.float64()) for one in parts)
    return pc.add(pc.multiply(pc.add(pc.multiply(hours, 60.0), minutes), 60.0), seconds)


def _tell_head(form: _Form, there: Sequence[str]) -> Iterator[str]:
    """Tell of lines that are left out before the rows, and of names that several columns have."""
    if form.n_left_out:
        yield (
            f"{pluralize(form.n_left_out, 'line')} without numbers before the rows of numbers "
            f"{'is' if form.n_left_out == 1 else 'are'} left out"
        )
    twice = next((name for name in there if there.count(name) > 1), None)
    if twice is not None:
        yield f"has {there.count(twice)} columns {twice!r}; give each its own name"


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
        tried = [_try_form(_rows(text, one), one, decimal, wanted) for one, decimal in forms]
    except (csv.Error, TypeError) as error:
        raise RobotError(f"{path}: cannot be read as a table: {error}") from error
    form, _ = max(tried, key=lambda one: one[1])
    if form.n_columns == 0:
        raise RobotError(f"{path}: has no rows; name a log with samples")
    return form


def _rows(text: str, separator: str) -> list[Row]:
    if separator == " ":
        return [(k, line.split()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    return [(reader.line_num, row) for row in reader if row]


def _try_form(
    rows: Sequence[Row], separator: str, decimal: str, wanted: Sequence[str] | None
) -> tuple[_Form, tuple[bool, int]]:
    """Divide rows into head and body, and find the header.

    Returns:
        The form, whether the header has all wanted names, and the numbers in rows as long as it.
    """
    cells = [row for _, row in rows]
    counts = [sum(_is_number(cell, decimal) for cell in row) for row in cells]
    n = 0
    while n < len(cells) and (not counts[n] or cells[n][0].startswith("#")):
        n += 1
    if n == len(cells):
        n = min(n, 1)  # a header alone, or texts alone
    elif n == 0 and (_is_named(cells[0], wanted) or _has_text_over_numbers(cells, decimal)):
        n = 1
        while n < len(cells) and not counts[n]:
            n += 1
    length = Counter(map(len, cells[n:] or cells)).most_common(1)[0][0] if cells else 0
    heads = [name for name in map(_plain_names, cells[:n]) if len(name) == length]
    if not heads and not all(row[0].startswith("#") for row in cells[:n]):
        heads = cells[:1]  # rows of another length are told when they are read
    wished = [name for name in heads if wanted is not None and set(wanted) <= set(name)]
    header = max(wished or heads, key=lambda name: len({*name} - {""}), default=None)
    n_columns = length if header is None else len(header)
    fitting = sum(count for row, count in zip(cells[n:], counts[n:], strict=True) if len(row) == n_columns)
    n_left_out = n if header is None else n - 1
    form = _Form(separator, decimal, header, n_columns, rows[n - 1][0] if n else 0, n_left_out)
    return form, (bool(wished) and bool(wanted), fitting)


def _plain_names(row: list[str]) -> list[str]:
    """Return the cells of a row without the mark of a comment, which numpy writes before its header."""
    if not row[0].startswith("#"):
        return row
    first = row[0].lstrip("#").strip()
    return [first, *row[1:]] if first else row[1:]


def _is_number(cell: str, decimal: str) -> bool:
    return NUMBER.fullmatch(cell if decimal == "." else cell.replace(",", ".", 1)) is not None


def _is_named(first: Sequence[str], wanted: Sequence[str] | None) -> bool:
    """Tell whether a row of numbers is a header: it has the wanted names, or counts 0, 1, 2 and so on."""
    if wanted is not None:
        return set(wanted) <= set(first)
    return list(first) == [str(k) for k in range(len(first))] and len(first) > 1


def _has_text_over_numbers(rows: Sequence[Sequence[str]], decimal: str) -> bool:
    """Tell whether the first row has a word where a later one has a number, so that it is a header."""
    return any(
        cell.strip() and not _is_number(cell, decimal) and k < len(row) and _is_number(row[k], decimal)
        for row in rows[1:]
        for k, cell in enumerate(rows[0])
    )


def open_json_lines(path: Path, wanted: Sequence[str] | None) -> TableLog:
    """Open a file with one JSON object a line; RobotError if one is none, or a column is of several kinds.

    Objects in it are records, lists are lists. A last line that is cut is left out, and the log tells it.
    """
    lines = read_whole(path).rstrip().split(b"\n")
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
            before = pluralize(len(rows), "line")
            losses = [f"line {number} is cut, where the file ends; the {before} before it are used"]
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
