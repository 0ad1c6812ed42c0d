"""Targets of a batch from a file, .npz or Parquet; nothing in the file is trusted."""

import os
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.requests import BadRequest
from ground.ik.targets import Targets, checked_targets

SUFFIXES: Final = (".npz", ".parquet")
ZIP_MAGIC: Final = b"PK\x03\x04"
POSITION: Final = ("position_x_m", "position_y_m", "position_z_m")
APPROACH: Final = ("approach_x", "approach_y", "approach_z")


def read_targets(path: Path, frame: str) -> Targets:
    """The targets of a file: `position_m` and `approach` (n, 3), or in Parquet a column for each component.

    Raises:
        BadRequest: the file cannot be read, lacks an array or a column, or holds a target that is none.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise BadRequest(f"batch {path}: its name must end in {' or '.join(SUFFIXES)}")
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe, say, which would never end
        raise BadRequest(f"batch {path}: is not a regular file")
    with _refusing(path):
        position, approach = _from_npz(path) if suffix == ".npz" else _from_parquet(path)
    if position.shape[1] != approach.shape[1]:
        raise BadRequest(
            f"batch {path}: there are {position.shape[1]} positions and {approach.shape[1]} approaches"
        )
    if position.shape[1] == 0:
        raise BadRequest(f"batch {path}: there is no target in it; give at least one")
    names = ("position_m", "approach") if suffix == ".npz" else (", ".join(POSITION), ", ".join(APPROACH))

    def naming(row: int) -> tuple[str, str]:
        where = f"batch {path}: row {row} (the first is 0): "
        return where + names[0], where + names[1]

    return checked_targets(position, approach, frame, naming)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """What the readers of files raise about files that are torn, or of another kind, becomes a sentence."""
    kind = "a NumPy .npz file" if path.suffix.lower() == ".npz" else "a Parquet file"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files from other times
            yield
    except BadRequest:
        raise
    except MemoryError as error:
        raise BadRequest(f"batch {path}: is too large for the memory; give it in parts") from error
    except OSError as error:
        if error.strerror is None:  # of the readers, not of the machine
            raise BadRequest(f"batch {path}: cannot be read as {kind}: {_short(error)}") from error
        raise BadRequest(f"batch {path}: cannot be read ({error.strerror})") from error
    except Exception as error:  # torn headers end in a tokenizer, a decompressor, anywhere
        raise BadRequest(f"batch {path}: cannot be read as {kind}: {_short(error)}") from error


def _short(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _from_npz(path: Path) -> tuple[Array, Array]:
    """Positions and approaches, (3, n) each."""
    with path.open("rb") as file:
        if file.read(len(ZIP_MAGIC)) != ZIP_MAGIC or not zipfile.is_zipfile(file):
            raise BadRequest(f"batch {path}: is not a NumPy .npz file, or only a part of one")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            missing = [name for name in ("position_m", "approach") if name not in arrays.files]
            if missing:
                raise BadRequest(
                    f"batch {path}: there is no array {' and no '.join(missing)}; "
                    f"it must hold position_m (n, 3) and approach (n, 3), it holds {_listed(arrays.files)}"
                )
            return _three(path, "position_m", arrays["position_m"]), _three(
                path, "approach", arrays["approach"]
            )


def _three(path: Path, name: str, values: object) -> Array:
    """An array (n, 3) of real numbers as (3, n)."""
    if not isinstance(values, np.ndarray):
        raise BadRequest(f"batch {path}: {name} is not an array")
    if values.ndim != 2 or values.shape[1] != 3:
        raise BadRequest(f"batch {path}: {name} has the shape {values.shape}, not (n, 3)")
    if values.dtype.kind not in "fiu":
        raise BadRequest(f"batch {path}: {name} holds {values.dtype}, not real numbers")
    with np.errstate(over="ignore"):  # of longer numbers
        return np.ascontiguousarray(values.T, dtype=np.float64)


def _from_parquet(path: Path) -> tuple[Array, Array]:
    """Positions and approaches, (3, n) each; a null is NaN."""
    from pyarrow import parquet, types

    with path.open("rb") as source, parquet.ParquetFile(source, page_checksum_verification=True) as file:
        there = file.schema_arrow.names
        missing = [name for name in (*POSITION, *APPROACH) if there.count(name) != 1]
        if missing:
            raise BadRequest(
                f"batch {path}: there must be one column {' and one '.join(missing)}; it has {_listed(there)}"
            )
        table = file.read(columns=[*POSITION, *APPROACH])
    for column in table.schema:
        if not types.is_floating(column.type) and not types.is_integer(column.type):
            raise BadRequest(f"batch {path}: {column.name} holds {column.type}, not real numbers")
    position, approach = (
        np.array([table.column(name).to_numpy() for name in names], dtype=np.float64)
        for names in (POSITION, APPROACH)
    )
    return position, approach


def _listed(names: list[str]) -> str:
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "nothing"
