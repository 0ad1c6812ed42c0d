"""Tables in binary files: Parquet, npz, and the folder of a LeRobot data set."""

import io
import json
import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simgap.common.errors import RobotError
from simgap.files.table_log import TableLog, base_columns, check_size, open_table

INFO: Final = "meta/info.json"
"""Information file of a LeRobot data set, in its folder."""
N_PARENTS: Final = 3
"""Folders above a data file in which the information file is looked for: data/chunk-000, data, the set."""
TIME: Final = "timestamp"
"""Column of a LeRobot data set with the seconds since the start of the episode."""
EPISODE: Final = "episode_index"
ZIP_ERRORS: Final = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(NotImplementedError, RuntimeError, EOFError, ValueError, LookupError),
)
"""Errors of a damaged zip file, and of the arrays in it."""


def open_parquet(path: Path, wanted: Sequence[str] | None) -> TableLog:
    """Open a Parquet file, with names of the LeRobot data set around it; RobotError if it lacks a column."""
    info = next((one / INFO for one in list(path.parents)[:N_PARENTS] if (one / INFO).is_file()), None)
    names = {} if info is None else _item_names(info)
    table = _read_parquet(path, wanted)
    return open_table(path, _by_name(table), wanted or (), names=names)


def open_lerobot(folder: Path, wanted: Sequence[str] | None) -> TableLog:
    """Open a LeRobot data set, v2 or v3, whose episodes are motions; RobotError if a part is missing."""
    paths = sorted(folder.glob("data/**/*.parquet"))
    if not paths:
        raise RobotError(f"{folder}: has no Parquet files in data; load them, or name another folder")
    tables = []
    for path in paths:
        try:
            tables.append(_read_parquet(path, None if wanted is None else [*wanted, TIME, EPISODE]))
        except (OSError, ValueError, pa.ArrowException) as error:
            raise RobotError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    check_size(folder, sum(one.num_rows * one.num_columns for one in tables))
    columns = _by_name(pa.concat_tables(tables, promote_options="permissive"))
    n_rows, n_meant = len(columns[TIME]), _read_info(folder / INFO).get("total_frames")
    losses = [f"has {n_rows} rows, its {INFO} says {n_meant}: data files are missing; the others are used"]
    return open_table(
        folder,
        columns,
        wanted or (),
        names=_item_names(folder / INFO),
        units={TIME: "s"},
        losses=losses if isinstance(n_meant, int) and n_meant != n_rows else (),
        time_column=TIME,
        motion_column=EPISODE,
    )


def open_npz(path: Path, wanted: Sequence[str] | None) -> TableLog:
    """Open an npz file, arrays of several dimensions as lists; RobotError if it is damaged or lacks one.

    An array with a column for each sample, as columns of one dimension tell, is transposed. Each is read to
    its end, because only then is its checksum compared.
    """
    if not zipfile.is_zipfile(path):
        raise RobotError(f"{path}: is no NumPy .npz file, or is damaged; name another")
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            members = {one.filename.removesuffix(".npy"): one for one in archive.infolist()}
            for name in base_columns(path, wanted, list(members)):
                check_size(path, members[name].file_size // 8)
                file = io.BytesIO(archive.read(members[name]))
                arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
    except ZIP_ERRORS as error:
        raise RobotError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    if wanted is None:  # a number alone is no column
        arrays = {name: array for name, array in arrays.items() if array.ndim and array.size}
    n_rows = max((one.size for one in arrays.values() if one.ndim == 1), default=0)
    is_long = {name: one.ndim == 2 and one.shape[1] == n_rows > one.shape[0] for name, one in arrays.items()}
    turned = {name: one.T for name, one in arrays.items() if is_long[name]}
    losses = [
        f"{name!r} has {one.shape[1]} rows of {n_rows} values: it is transposed, to have a row a sample"
        for name, one in turned.items()
    ]
    columns = {name: _to_arrow(path, name, one) for name, one in (arrays | turned).items()}
    return open_table(path, columns, wanted or (), losses=losses)


def _to_arrow(path: Path, name: str, array: NDArray[Any]) -> pa.Array:
    """Convert an array of n dimensions to a column of lists of lists."""
    if array.ndim == 0 or 0 in array.shape[1:] or array.dtype.kind not in "fiubSUM":
        raise RobotError(
            f"{path}: array {name!r} is {array.dtype} of shape {array.shape}; a column needs numbers or "
            "texts in one dimension or more"
        )
    flat = np.ascontiguousarray(array).reshape(-1)
    if array.dtype.kind == "S":
        flat = np.char.decode(flat, "utf-8", "replace")
    if array.dtype.kind == "f" and array.dtype.itemsize > 8:
        flat = flat.astype(np.float64)
    if array.dtype.kind == "M":
        flat = flat.astype("datetime64[us]")
    found = pa.array(flat.astype(flat.dtype.newbyteorder("=")))
    for length in reversed(array.shape[1:]):
        found = pa.FixedSizeListArray.from_arrays(found, length)
    return found


def _read_parquet(path: Path, wanted: Sequence[str] | None) -> pa.Table:
    """Read columns of a file, and compare the checksums of its pages if it has any."""
    schema = pq.read_schema(path)
    there = [one.name for one in schema if wanted is not None or not _is_binary(one.type)]
    chosen = base_columns(path, wanted, there)
    n_rows = pq.read_metadata(path).num_rows
    check_size(path, n_rows * len(chosen))
    table = pq.read_table(path, columns=chosen, page_checksum_verification=True, partitioning=None)
    if table.num_rows != n_rows:
        raise RobotError(f"{path}: is damaged: it has {table.num_rows} rows, its footer says {n_rows}")
    for k, one in enumerate(table.schema):  # a dictionary is how a column is stored, not what it holds
        if pa.types.is_dictionary(one.type):
            table = table.set_column(k, one.name, table[k].cast(one.type.value_type))
    return table


def _is_binary(kind: pa.DataType) -> bool:
    """Tell whether a column has pictures, which no list of columns should read."""
    if pa.types.is_struct(kind):
        return any(_is_binary(one.type) for one in kind)
    return bool(pa.types.is_binary(kind) or pa.types.is_large_binary(kind))


def _by_name(table: pa.Table) -> dict[str, pa.ChunkedArray]:
    return dict(zip(table.column_names, table.columns, strict=True))


def _read_info(path: Path) -> dict[str, Any]:
    """Read the information file of a data set."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RobotError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    if not isinstance(found, dict):
        raise RobotError(f"{path}: is no JSON object; load the data set anew")
    return found


def _item_names(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of the items of each column of lists."""
    features = _read_info(path).get("features")
    if not isinstance(features, Mapping):
        return {}
    found = {}
    for name, one in features.items():
        names = one.get("names") if isinstance(one, Mapping) else None
        if isinstance(names, Mapping):  # {"motors": [...]}, as some versions write
            names = [item for part in names.values() if isinstance(part, Iterable) for item in part]
        if isinstance(names, list) and names and all(isinstance(item, str) for item in names):
            found[name] = tuple(names)
    return found
