"""Log files of all formats: `open_log` reads columns of one, `open_whole` all."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.message_log import MessageLog
from simgap.files.robot_file import CsvTable
from simgap.files.table_files import INFO, open_lerobot, open_npz, open_parquet
from simgap.files.table_log import TableLog
from simgap.files.text_files import open_csv, open_json_lines

METADATA: Final = "metadata.yaml"
"""File of a folder that is a bag of ROS 2."""

LogFile = TableLog | MessageLog
"""Log that is open for reading, one column at a time."""
TEXT_SUFFIXES: Final = (".csv", ".tsv", ".txt")
PACKED: Final = (*TEXT_SUFFIXES, ".jsonl", ".ndjson")
"""Suffixes of files that are read as they are packed by gzip, with `.gz` behind."""
Opener = Callable[[Path, Sequence[str] | None], LogFile]
TABLES: Final[dict[str, Opener]] = {
    ".parquet": open_parquet,
    ".jsonl": open_json_lines,
    ".ndjson": open_json_lines,
    ".npz": open_npz,
}
"""Functions that open a table by its suffix; text with separators needs more."""
MESSAGES: Final = (".mcap", ".db3", ".bag")
"""Suffixes of files of messages, which have no rows and so no texts."""
SUFFIXES: Final = (*TABLES, *TEXT_SUFFIXES, *MESSAGES)


def open_log(path: Path, numbers: Sequence[str], texts: Sequence[str], csv_table: CsvTable) -> LogFile:
    """Open columns of numbers and texts of a log, a file or a folder; RobotError if it lacks one."""
    return _open(path, numbers, [one for one in texts if one not in numbers], csv_table)


def open_whole(path: Path) -> LogFile:
    """Open a log with all of its columns; RobotError if the file cannot be read, or has no rows."""
    return _open(path, None, (), CsvTable())


def read_times(log: LogFile, column: str, form: str = "") -> Array:
    """Read a time column, (n,), of numbers or of texts as `strptime` reads them; RobotError for no time."""
    if form:
        texts = pc.utf8_trim_whitespace(pa.array(log.texts(column)))
        read = pc.strptime(texts, form, "us", error_is_null=True)
        time_s = pc.divide(read.cast(pa.int64()).cast(pa.float64()), 1e6).to_numpy(zero_copy_only=False)
    else:
        clock = log.numbers(column)
        time_s = clock.value if clock.is_present is None else np.where(clock.is_present, clock.value, np.nan)
    bad = np.flatnonzero(~np.isfinite(time_s))
    if bad.size:
        row = int(bad[0])
        why = f"{texts[row].as_py()!r:.60} is no time as {form!r} has it" if form else "has no time; give one"
        raise RobotError(f"{log.path}: row {row + 1}, column {column!r}: {why}")
    return np.asarray(time_s, np.float64)


def _open(path: Path, numbers: Sequence[str] | None, texts: Sequence[str], csv_table: CsvTable) -> LogFile:
    wanted = None if numbers is None else list(dict.fromkeys([*numbers, *texts]))
    try:
        if os.path.isdir(path):  # unlike Path.is_dir, False for any bad name
            return _open_folder(path, numbers, wanted)
        _check_file(path)
        suffix = path.suffix.lower()
        if suffix == ".gz":
            suffix = Path(path.stem).suffix.lower()
            if suffix not in PACKED:
                raise RobotError(f"{path}: is packed; unpack it with gunzip, and name what it holds")
        if suffix in TEXT_SUFFIXES:
            return open_csv(path, wanted, texts, csv_table)
        if suffix in TABLES:
            return TABLES[suffix](path, wanted)
        if suffix in MESSAGES:
            return _open_messages(path, numbers)
    except (OSError, OverflowError, ValueError, pa.ArrowException) as error:
        raise RobotError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    except MemoryError as error:
        raise RobotError(f"{path}: is too large for the memory; give it in parts") from error
    raise RobotError(
        f"{path}: is no log by its suffix; name a file that ends in one of {', '.join(SUFFIXES)}"
    )


def _open_folder(folder: Path, numbers: Sequence[str] | None, wanted: Sequence[str] | None) -> LogFile:
    if (folder / INFO).is_file():
        return open_lerobot(folder, wanted)
    if (folder / METADATA).is_file() or any(folder.glob("*.mcap")):
        return _open_messages(folder, numbers)
    if any(folder.glob("*.db3")):
        raise RobotError(
            f"{folder}: has no {METADATA}; `ros2 bag reindex {folder}` writes it, or name one .db3 file"
        )
    raise RobotError(
        f"{folder}: is no regular file; name a log, or the folder of a LeRobot data set with {INFO}, or of a "
        f"ROS 2 bag with {METADATA}"
    )


def _open_messages(path: Path, names: Sequence[str] | None) -> MessageLog:
    from simgap.files.bag_log import open_bag  # its libraries load slowly, and tables need none

    return open_bag(path, names)


def _check_file(path: Path) -> None:
    if not os.path.isfile(path):
        if os.path.exists(path):
            raise RobotError(f"{path}: is no regular file; name a log")
        raise RobotError(f"{path}: there is no such log; name a file that exists")
    if path.stat().st_size == 0:
        raise RobotError(f"{path}: is an empty file; name a log with samples")
