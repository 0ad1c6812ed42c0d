"""Campaign of damaged logs of any robot: single bits are flipped in a log of each format.

Each flip must end in an error of the user, or in the numbers as they were written. Where the format has a
checksum, no other number may be read without a sentence about it.
"""

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from simgap.common.errors import RobotError
from simgap.files.columns import Column
from simgap.files.log_file import list_columns, open_log
from simgap.files.robot_file import CsvTable
from validation.campaigns import Context, Document

N_ROWS: Final = 120
START_NS: Final = 10**18
PERIOD_NS: Final = 10**7
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
TABLE_COLUMNS: Final = ("t", "j1", "j2")
MESSAGE_COLUMNS: Final = ("/joint_states.position[j1]", "/joint_states.position[j2]")
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LogFormat:
    """Format of logs, with a writer of one."""

    name: str
    """Name of the file."""
    write: Callable[[Path, Values], None]
    """Function that writes times and two positions, (3, n)."""
    columns: tuple[str, ...]
    has_checksum: bool


def write_csv(path: Path, values: Values) -> None:
    """Write a table of text."""
    pacsv.write_csv(pa.table(dict(zip(TABLE_COLUMNS, values, strict=True))), path)


def write_json_lines(path: Path, values: Values) -> None:
    """Write an object a line."""
    rows = (json.dumps(dict(zip(TABLE_COLUMNS, row, strict=True))) for row in values.T.tolist())
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_npz(path: Path, values: Values) -> None:
    """Write arrays, compressed."""
    np.savez_compressed(path, **dict(zip(TABLE_COLUMNS, values, strict=True)))


def write_parquet(path: Path, values: Values) -> None:
    """Write Parquet with a checksum of each page."""
    pq.write_table(pa.table(dict(zip(TABLE_COLUMNS, values, strict=True))), path, write_page_checksum=True)


def write_mcap(path: Path, values: Values, is_chunked: bool = True) -> None:
    """Write messages of ROS 2 in MCAP; without chunks the checksum is that of all data."""
    store = get_typestore(Stores.LATEST)
    definition, _ = store.generate_msgdef(JOINT_STATE)
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=4096,
            compression=CompressionType.ZSTD,
            use_chunking=is_chunked,
            enable_data_crcs=not is_chunked,  # else the chunks have theirs, and the writer sets none
        )
        writer.start("ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for time_ns, message in joint_states(store, values):
            data = bytes(store.serialize_cdr(message, JOINT_STATE))
            writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates only part of itself


def write_unchunked(path: Path, values: Values) -> None:
    """Write MCAP without chunks."""
    write_mcap(path, values, is_chunked=False)


def write_bag(path: Path, values: Values, compression: Writer1.CompressionFormat | None = None) -> None:
    """Write a bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=store)
        for time_ns, message in joint_states(store, values, seq=0):
            writer.write(connection, time_ns, store.serialize_ros1(message, JOINT_STATE))


def write_compressed_bag(path: Path, values: Values) -> None:
    """Write a bag of ROS 1 whose chunks bzip2 packs, with its checksum."""
    write_bag(path, values, Writer1.CompressionFormat.BZ2)


def write_db3(path: Path, values: Values) -> None:
    """Write the SQLite file of a bag of ROS 2."""
    store = get_typestore(Stores.LATEST)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bag"
        with Writer2(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=store)
            for time_ns, message in joint_states(store, values):
                writer.write(connection, time_ns, store.serialize_cdr(message, JOINT_STATE))
        path.write_bytes((folder / "bag.db3").read_bytes())


def joint_states(store: Any, values: Values, **header: Any) -> Iterable[tuple[int, Any]]:
    """Yield times and messages; the order of the joints changes with each."""
    time_type, header_type = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    for k, (_, *position) in enumerate(values.T):
        order = [0, 1] if k % 2 else [1, 0]
        stamp = time_type(sec=k // 100, nanosec=k % 100 * PERIOD_NS)
        yield (
            START_NS + k * PERIOD_NS,
            store.types[JOINT_STATE](
                header=header_type(stamp=stamp, frame_id="", **header),
                name=[("j1", "j2")[one] for one in order],
                position=np.array(position)[order],
                velocity=np.zeros(0),
                effort=np.zeros(0),
            ),
        )


FORMATS: Final = (
    LogFormat("log.csv", write_csv, TABLE_COLUMNS, False),
    LogFormat("log.jsonl", write_json_lines, TABLE_COLUMNS, False),
    LogFormat("log.npz", write_npz, TABLE_COLUMNS, True),
    LogFormat("log.parquet", write_parquet, TABLE_COLUMNS, True),
    LogFormat("log.mcap", write_mcap, MESSAGE_COLUMNS, True),
    LogFormat("unchunked.mcap", write_unchunked, MESSAGE_COLUMNS, True),
    LogFormat("log.bag", write_bag, MESSAGE_COLUMNS, False),
    LogFormat("bzip2.bag", write_compressed_bag, MESSAGE_COLUMNS, True),
    LogFormat("log.db3", write_db3, MESSAGE_COLUMNS, False),
)


def make_values(random: np.random.Generator, n: int = N_ROWS) -> Values:
    """Make times and two positions, (3, n)."""
    return np.stack([np.arange(n) * 0.01, *np.cumsum(random.normal(size=(2, n)), axis=1)])


def read_all(path: Path, columns: tuple[str, ...]) -> tuple[list[Column], tuple[str, ...]]:
    """Read columns of a log, and what was told of it."""
    log = open_log(path, columns, (), CsvTable())
    return [log.numbers(name) for name in columns], tuple(log.losses)


def judge(path: Path, columns: tuple[str, ...], written: list[Column], has_checksum: bool) -> str:
    """Judge the reading of a damaged log; the text begins with WRONG if it is a bug."""
    try:
        list_columns(path)
    except RobotError:
        pass
    except Exception as error:
        return f"WRONG: {type(error).__name__} in a list: {error}"
    try:
        found, losses = read_all(path, columns)
    except RobotError as error:
        return "WRONG: two lines" if "\n" in str(error) else "refused"
    except Exception as error:
        return f"WRONG: {type(error).__name__}: {error}"
    if all(map(is_same, found, written)):
        return "harmless"
    if losses:
        return "told"
    return "WRONG: other numbers" if has_checksum else "other numbers"


def is_same(one: Column, other: Column) -> bool:
    """Tell whether two columns have the same numbers at the same times."""
    pairs = ((one.value, other.value), (one.time_s, other.time_s), (one.is_present, other.is_present))
    return all(
        a is b or (a is not None and b is not None and np.array_equal(a, b, equal_nan=True)) for a, b in pairs
    )


def flip_bits(form: LogFormat, tries: int, seed: int, folder: Path) -> Document:
    """Flip bits of a log, one at a time, and count the judgements."""
    random = np.random.default_rng(seed)
    path = folder / form.name
    form.write(path, make_values(random))
    data = path.read_bytes()
    written, _ = read_all(path, form.columns)
    counts, wrong = Counter[str](), []
    offsets, bits = random.integers(len(data), size=tries), random.integers(8, size=tries)
    for at, bit in zip(offsets.tolist(), bits.tolist(), strict=True):
        damaged = bytearray(data)
        damaged[at] ^= 1 << bit
        path.write_bytes(damaged)
        judged = judge(path, form.columns, written, form.has_checksum)
        counts[judged.partition(":")[0]] += 1
        if judged.startswith("WRONG"):
            wrong.append({"byte": at, "bit": bit, "why": judged})
    return {"format": form.name, "bytes": len(data), **counts, "wrong": wrong}


def campaign(context: Context, tries: int = 2000) -> Document:
    """Flip bits of a log of each format; in bounds if none is a bug.

    Args:
        context: Gives the seed of logs and flips.
        tries: Flips of each format.
    """
    with tempfile.TemporaryDirectory() as name:
        jobs = [(form, tries, context.seed, Path(name)) for form in FORMATS]
        found = context.each(flip_bits, jobs, "formats")
    return {
        "formats": {one["format"]: one for one in found},
        "in_bounds": not any(one["wrong"] for one in found),
    }
