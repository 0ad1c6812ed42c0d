"""A bounded, seeded run of the fuzz target: bytes changed, doubled, cut and mixed."""

import io
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

from tests.ground.imports.fuzz import BETWEEN, import_once

TRIES = 1500
MAPPING = b"""[time]
column = "t"
unit = "s"
grid = "linear"
sort = true
[csv]
separator = ","
[[channel]]
name = "/joint.motor_rad"
columns = ["a", "b", "c", "d", "e"]
unit = "deg"
gain = -1
[[channel]]
name = "/joint.mode"
columns = "mode"
[[channel]]
name = "/imported/arm.on"
columns = "on"
unit = "bool"
[[channel]]
name = "/imported/arm.steps_count"
columns = "n"
unit = "count"
"""
WORDS = [b"nan", b"inf", b"-1", b"1e308", b"99999999999999999999", b"true", b"", b"\xff", b"\0", b"0", b'"']


def tables() -> list[bytes]:
    columns: dict[str, Any] = {name: np.linspace(-1, 1, 6) for name in "abcde"}
    columns |= {
        "t": np.arange(6) / 64,
        "mode": ["STOWED"] * 6,
        "on": [True, False] * 3,
        "n": range(6),
    }
    text, binary, plain = io.BytesIO(), io.BytesIO(), io.BytesIO()
    table = pa.table({k: pa.array(v) for k, v in columns.items()})
    csv.write_csv(table, text)
    parquet.write_table(table, binary)
    parquet.write_table(table, plain, compression="none", use_dictionary=False, version="1.0")
    return [text.getvalue(), binary.getvalue(), plain.getvalue()]


def changed(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one to four changes."""
    made = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(made) + 1))
        end = min(len(made), at + int(rng.integers(1, 40)))
        match int(rng.integers(6)):
            case 0 if at < len(made):
                made[at] ^= 1 << int(rng.integers(8))
            case 1:
                made[at:end] = b""
            case 2:
                made[at:at] = made[at:end]
            case 3:
                made[at:at] = WORDS[int(rng.integers(len(WORDS)))]
            case 4:
                made[at:end] = rng.bytes(end - at)
            case 5:
                del made[at:]
    return bytes(made)


def test_what_is_changed_is_imported_or_refused_and_nothing_else_happens() -> None:
    rng = np.random.default_rng(6)
    seeds = tables()
    assert all(import_once(MAPPING + BETWEEN + table) for table in seeds)
    outcomes = []
    for k in range(TRIES):
        mapping, table = MAPPING, seeds[k % 3]
        if k % 2:
            mapping = changed(mapping, rng)
        else:
            table = changed(table, rng)
        outcomes.append(import_once(mapping + BETWEEN + table))
    assert 0 < sum(outcomes) < TRIES


@pytest.mark.parametrize(
    "data",
    [b"", BETWEEN, b"\0" * 100, b"[" * 5000 + BETWEEN, MAPPING, MAPPING + BETWEEN, b"a=" + b"[" * 5000],
)
def test_what_is_hardly_a_file_is_refused(data: bytes) -> None:
    assert not import_once(data)
