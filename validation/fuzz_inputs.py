"""Inputs for the fuzzer: mutated logs, mutated tables and mappings, and the import target."""

import io
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import pyarrow as pa
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC
from pyarrow import csv, parquet

from marsarm.telemetry.format import FORMAT_RECORD, HEADER_RECORD, header_records
from marsarm.telemetry.import_table import convert_table, write_table_log
from marsarm.telemetry.log_writer import RECORD_HEAD, encode_records
from marsarm.telemetry.mcap_columns import PARSE_ERRORS, unpack_chunk
from marsarm.telemetry.read import read_log
from simgap.common.errors import RobotError

Random = np.random.Generator
Mutator = Callable[[Random, bytearray], None]
NUMBERS: Final = (0, 1, 0x80, 1 << 40, *((1 << bits) - 1 for bits in (7, 8, 16, 31, 32, 63, 64)))
"""Values that lengths and offsets are likely to mishandle."""
LONGEST: Final = 1 << 20
"""Inputs of this length are not extended."""


def place(random: Random, data: bytes | bytearray) -> int:
    """Return a random offset in the data, most often near its beginning or end."""
    near = int(random.integers(64))
    return int(random.choice((int(random.integers(len(data) + 1)), near, len(data) - near)))


def flip(random: Random, data: bytearray) -> None:
    """Flip some bits."""
    for _ in range(int(random.integers(1, 5))):
        if data:
            data[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))


def number(random: Random, data: bytearray) -> None:
    """Overwrite some bytes with a number."""
    size = int(random.choice((1, 2, 4, 8)))
    value = int(NUMBERS[int(random.integers(len(NUMBERS)))]) & ((1 << 8 * size) - 1)
    at = max(0, place(random, data))
    data[at : at + size] = value.to_bytes(size, "little")


def cut(random: Random, data: bytearray) -> None:
    """Delete a part, or everything from an offset on."""
    at = max(0, place(random, data))
    del data[at : at + int(random.integers(1, 256)) if random.random() < 0.7 else None]


def repeat(random: Random, data: bytearray) -> None:
    """Insert a copy of a part at another offset."""
    if len(data) < LONGEST:
        at, to = max(0, place(random, data)), max(0, place(random, data))
        data[to:to] = data[at : at + int(random.integers(1, 4096))]


def noise(random: Random, data: bytearray) -> None:
    """Overwrite a part with random bytes."""
    at = max(0, place(random, data))
    data[at : at + 16] = random.bytes(int(random.integers(1, 32)))


MUTATORS: Final[tuple[Mutator, ...]] = (flip, number, cut, repeat, noise)


WORDS: Final = (b"nan", b"inf", b"-1", b"1e308", b"99999999999999999999", b"true", b"\xff", b"\0", b"0", b'"')
"""Texts that tables and mappings are likely to mishandle."""


def word(random: Random, data: bytearray) -> None:
    """Insert a text."""
    at = max(0, place(random, data))
    data[at:at] = WORDS[int(random.integers(len(WORDS)))]


TEXT_MUTATORS: Final = (*MUTATORS, word)


def mutate_bytes(random: Random, data: bytes, mutators: Sequence[Mutator] = MUTATORS) -> bytes:
    """Return the bytes with one to three random mutations."""
    out = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        mutators[int(random.integers(len(mutators)))](random, out)
    return bytes(out)


def mutate_records(random: Random, data: bytes) -> bytes:
    """Mutate the records of a chunk of a log, or its header, and update the CRCs."""
    chunks, metadata = parts(data)
    if not chunks or random.random() < 0.2:
        return mutate_header(random, data, metadata)
    begin, end = chunks[int(random.integers(len(chunks)))]
    chunk = Chunk.read(ReadDataStream(io.BytesIO(data[begin + RECORD_HEAD.size : end])))
    try:
        plain = mutate_bytes(random, unpack_chunk(chunk))
    except PARSE_ERRORS:
        return mutate_bytes(random, data)
    packed = replace(
        chunk,
        data=zstandard.compress(plain),
        uncompressed_size=len(plain),
        uncompressed_crc=zlib.crc32(plain),
    )
    return data[:begin] + encode_records(packed) + data[end:]


def parts(data: bytes) -> tuple[list[tuple[int, int]], dict[str, tuple[int, int]]]:
    """Find begin and end of the chunks, and of the format and header records, up to the first broken one."""
    chunks, metadata, at = [], {}, len(MCAP0_MAGIC)
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        end = at + RECORD_HEAD.size + length
        if opcode == Opcode.CHUNK and end <= len(data):
            chunks.append((at, end))
        for name in (FORMAT_RECORD, HEADER_RECORD):
            if opcode == Opcode.METADATA and data.startswith(name.encode(), at + RECORD_HEAD.size + 4):
                metadata[name] = (at, end)
        at = end
    return chunks, metadata


def mutate_header(random: Random, data: bytes, metadata: dict[str, tuple[int, int]]) -> bytes:
    """Mutate a text in the header of a log, and update its CRC."""
    if len(metadata) < 2:
        return mutate_bytes(random, data)
    begin, (header_at, end) = metadata[FORMAT_RECORD][0], metadata[HEADER_RECORD]
    text = bytes(data[header_at:end]).decode("latin-1")
    names = [name for name in ("channels", "seed", "request", "params") if name in text] or ["channels"]
    name = names[int(random.integers(len(names)))]
    old = text.partition(name)[2][4:]
    header = {name: mutate_bytes(random, old.encode()).decode("latin-1")}
    return data[:begin] + encode_records(*header_records(header)) + data[end:]


BETWEEN: Final = b"\n#---\n"
"""Separator of mapping and table in an input."""


def import_once(data: bytes) -> bool:
    """Import an input, and return whether it was accepted; any exception is a bug."""
    mapping, _, table = data.partition(BETWEEN)
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "m.toml").write_bytes(mapping)
        path = folder / ("t.parquet" if table.startswith(b"PAR1") else "t.csv")
        path.write_bytes(table)
        try:
            made = convert_table(path, folder / "m.toml")
        except RobotError as error:
            if isinstance(error.__cause__, MemoryError):
                raise MemoryError(str(error)) from error  # a small table must not use all memory
            return False
        with (folder / "log.mcap").open("wb") as file:
            write_table_log(file, made)
        log = read_log(folder / "log.mcap")
    for one in made.series:
        assert log[one.spec.topic].tobytes() == one.data.tobytes()
    return True


MAPPING = b"""[time]
column = "t"
unit = "s"
grid = "linear"
sort = true
[csv]
separator = ","
[channels."/joint.motor_rad"]
columns = ["a", "b", "c", "d", "e"]
unit = "deg"
factor = -1
[channels."/joint.mode"]
columns = "mode"
[channels."/imported/arm.on"]
columns = "on"
unit = "bool"
[channels."/imported/arm.steps_count"]
columns = "n"
"""


def tables() -> list[bytes]:
    """Make a table as CSV and as two kinds of Parquet."""
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


ODD: list[Any] = [0.0, -0.0, 1.5, -1e308, 1e308, 5e-324, np.nan, np.inf, -np.inf, 2.0**53, 2.0**63, 1e-9]
WHOLE = [0, 1, -1, 2**53 + 1, 2**63 - 1, -(2**63), 15_625_000]


def random_column(rng: np.random.Generator, rows: int) -> Any:
    """Make a random column, which may have unusual and missing values."""
    mask = rng.random(rows) < rng.choice([0.0, 0.0, 0.0, 0.0, 0.3])  # a NaN of a text is missing too
    match int(rng.choice(6, p=[0.2, 0.15, 0.1, 0.03, 0.26, 0.26])):
        case 0:
            return pa.array(rng.choice(ODD, rows), mask=mask)
        case 1:
            most = 1 << (63 if rng.random() < 0.2 else 53)  # a number beyond 2^53 is refused
            whole = np.array([one for one in WHOLE if abs(one) <= most])
            return pa.array(rng.choice(whole, rows), mask=mask)
        case 2:
            return pa.array(rng.random(rows) < 0.5, mask=mask)
        case 3:
            return pa.array([("STOWED", "nan", "", "1,5")[k] for k in rng.integers(4, size=rows)])
        case _:
            return pa.array(rng.normal(size=rows), mask=mask)


def random_case(rng: np.random.Generator) -> bytes:
    """Make a mostly valid mapping, and a table of random columns."""
    rows = int(rng.integers(1, 12))
    columns = {name: random_column(rng, rows) for name in "abcden"}
    steps = rng.choice([1 / 64, 1 / 100, 1e-3, 0.5, 1e9], rows, p=[0.4, 0.3, 0.1, 0.15, 0.05])
    if rng.random() < 0.5:
        steps = np.full(rows, 1 / 64)
    columns["t"] = (
        random_column(rng, rows) if rng.random() < 0.1 else pa.array(np.cumsum(np.ones(rows) * steps))
    )

    def one_of(*words: str) -> str:
        return words[int(rng.integers(len(words)))]

    field, unit = one_of("n_count count", "n_m mm", "n_C K", "n bool", "n %", "n_m K").split()
    mapping = f"""[time]
column = "t"
unit = "{one_of("s", "s", "s", "s", "ms", "ns")}"
grid = "{one_of("exact", "nearest", "hold", "linear", "linear")}"
sort = {one_of("true", "false")}
tolerance_cycles = {one_of("0.01", "0.5", "0")}
max_interval_s = {one_of("1", "60", "60", "0.001")}
first_tick = {one_of("0", "5", "500000000000")}
[channels."{one_of("/joint.motor_rad", "/sensors.resolver_rad")}"]
columns = ["a", "b", "c", "d", "e"]
unit = "{one_of("rad", "deg", "turn")}"
factor = {one_of("1", "-1", "1e300", "[1, 2, 3, 4, 5]")}
offset = {one_of("0", "1e300", "-1")}
[channels."/imported/x.{field}"]
columns = "n"
unit = "{unit}"
[channels."/joint.mode"]
{one_of('columns = "n"', *['value = "STOWED"'] * 4)}
"""
    file = io.BytesIO()
    (parquet.write_table if rng.random() < 0.5 else csv.write_csv)(pa.table(columns), file)
    return mapping.encode() + BETWEEN + file.getvalue()


def import_seeds() -> list[bytes]:
    """Return valid inputs."""
    return [MAPPING + BETWEEN + table for table in tables()]


def mutate_import(rng: np.random.Generator, data: bytes) -> bytes:
    """Mutate the mapping or the table of an input, or make a random input."""
    mapping, _, table = data.partition(BETWEEN)
    match int(rng.integers(3)):
        case 0:
            return mutate_bytes(rng, mapping, TEXT_MUTATORS) + BETWEEN + table
        case 1:
            return mapping + BETWEEN + mutate_bytes(rng, table, TEXT_MUTATORS)
        case _:
            return random_case(rng)
