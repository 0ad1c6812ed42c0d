"""A flipped bit in a log ends in an error; if the format has a checksum, no number changes without a word."""

import json
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest

from helpers.message_logs import rows, write_bag, write_mcap
from simgap.common.errors import RobotError
from simgap.files.log_file import open_log, open_whole
from simgap.files.robot_file import CsvTable

N_ROWS = 120
TABLE = {f"j{k}": np.random.default_rng(k).normal(size=N_ROWS).cumsum() for k in (1, 2)}
TABLE = {"t": np.arange(N_ROWS) * 0.01} | TABLE
JOINTS = ("/joint_states.position[shoulder]", "/joint_states.position[elbow]")


def write_json_lines(path):
    table = np.transpose(list(TABLE.values())).tolist()
    row = (json.dumps(dict(zip(TABLE, one, strict=True))) for one in table)
    path.write_text("\n".join(row) + "\n")


def write_sqlite(path):
    write_bag(path.parent / "bag", rows(N_ROWS))
    path.write_bytes((path.parent / "bag" / "bag.db3").read_bytes())


@dataclass(frozen=True)
class LogFormat:
    name: str
    write: object
    columns: tuple[str, ...] = tuple(TABLE)
    has_checksum: bool = True


FORMATS = (
    LogFormat("log.csv", lambda path: pacsv.write_csv(pa.table(TABLE), path), has_checksum=False),
    LogFormat("log.jsonl", write_json_lines, has_checksum=False),
    LogFormat("log.npz", lambda path: np.savez_compressed(path, **TABLE)),
    LogFormat("log.parquet", lambda path: pq.write_table(pa.table(TABLE), path, write_page_checksum=True)),
    LogFormat("log.mcap", partial(write_mcap, messages=rows(N_ROWS)), JOINTS),
    LogFormat(
        "unchunked.mcap",
        partial(write_mcap, messages=rows(N_ROWS), use_chunking=False, enable_data_crcs=True),
        JOINTS,
    ),
    LogFormat("log.bag", partial(write_bag, messages=rows(N_ROWS)), JOINTS, False),
    LogFormat("bzip2.bag", partial(write_bag, messages=rows(N_ROWS), is_packed=True), JOINTS),
    LogFormat("log.db3", write_sqlite, JOINTS, False),
)


def read_all(form, path):
    """Read times and numbers of the columns, and what is told of the log."""
    log = open_log(path, form.columns, (), CsvTable())
    columns = [log.numbers(name) for name in form.columns]
    return [(one.value, one.time_s, one.is_present) for one in columns], log.losses


def is_same(found, written):
    """Tell whether all columns have the same numbers at the same times."""
    pairs = [pair for columns in zip(found, written, strict=True) for pair in zip(*columns, strict=True)]
    return all(
        a is b or (a is not None and b is not None and np.array_equal(a, b, equal_nan=True)) for a, b in pairs
    )


def judge(form, path, written):
    """Read a damaged log; any error but that of the user is a bug."""
    with suppress(RobotError):
        open_whole(path).describe()
    try:
        found, losses = read_all(form, path)
    except RobotError as error:
        return "refused" if "\n" not in str(error) else "two lines"
    return "harmless" if is_same(found, written) else "told" if losses else "other numbers"


@pytest.mark.parametrize(
    ("tries", "form"),
    [
        pytest.param(tries, form, marks=[pytest.mark.slow] if tries > 15 else [], id=f"{form.name}-{tries}")
        for tries, form in product((15, 100), FORMATS)
    ],
)
def test_a_flipped_bit_changes_no_number_without_a_word(form, tries, tmp_path):
    path, random = tmp_path / form.name, np.random.default_rng(tries)
    form.write(path)
    data, (written, _) = path.read_bytes(), read_all(form, path)
    judged = []
    for at, bit in zip(random.integers(len(data), size=tries), random.integers(8, size=tries), strict=True):
        damaged = bytearray(data)
        damaged[at] ^= 1 << bit
        path.write_bytes(damaged)
        judged.append(judge(form, path, written))
    assert "refused" in judged
    more = set() if form.has_checksum else {"other numbers"}
    assert set(judged) <= {"refused", "harmless", "told"} | more
