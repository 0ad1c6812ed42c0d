"""Targets of a batch from an .npz or Parquet file, with checks of all content."""

import os
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array
from marsarm.common.bad_tables import describe_bad_table
from marsarm.common.requests import MAX_TARGET_DISTANCE_M, MIN_COMPONENT, NEAR_HINT, format_numbers
from marsarm.ik.request import BATCH_SUFFIXES
from sim.frames import p_R_from_N
from simgap.common.errors import BadRequest

FRAMES: Final = ("rnav", "rmech")

TargetLabel = Callable[[int], tuple[str, str]]
"""Function from the index of a target to the names of its position and approach in messages."""
ZIP_MAGIC: Final = b"PK\x03\x04"
POSITION_COLUMNS: Final = ("position_x_m", "position_y_m", "position_z_m")
APPROACH_COLUMNS: Final = ("approach_x", "approach_y", "approach_z")


@dataclass(frozen=True, slots=True, eq=False)
class IkTargets:
    """Targets: position of the tool's origin and direction of its boresight, in RMECH."""

    p_RoTo_R_m: Array
    """Positions, shape (3, n)."""
    approach_R: Array
    """Unit vectors, shape (3, n)."""

    def __len__(self) -> int:
        return int(self.p_RoTo_R_m.shape[1])

    def part(self, start: int, count: int) -> "IkTargets":
        """Select `count` targets from index `start` on."""
        these = slice(start, start + count)
        return IkTargets(self.p_RoTo_R_m[:, these], self.approach_R[:, these])


def make_targets(position_m: Array, approach: Array, frame: str, naming: TargetLabel) -> IkTargets:
    """Build targets after checks.

    Args:
        position_m: Positions in `frame`, shape (3, n).
        approach: Directions of any length in rover axes, shape (3, n).
        frame: Name of the frame, of FRAMES.
        naming: Names of positions and approaches in messages.

    Returns:
        The targets.

    Raises:
        BadRequest: The frame is unknown, a number is not finite, a point is too far, or a direction is 0.
    """
    if frame not in FRAMES:
        raise BadRequest(f"frame: {frame!r} is not known; there are {', '.join(FRAMES)}")
    for which, values in enumerate((position_m, approach)):
        _refuse(~np.isfinite(values).all(axis=0), values, naming, which, "is not three finite numbers")
    with np.errstate(over="ignore"):
        distance = np.hypot(np.hypot(position_m[0], position_m[1]), position_m[2])
    _refuse(
        distance > MAX_TARGET_DISTANCE_M,
        position_m,
        naming,
        0,
        f"m is farther than {MAX_TARGET_DISTANCE_M:g} m from the rover; {NEAR_HINT}",
    )
    largest = np.abs(approach).max(axis=0)
    _refuse(
        largest < MIN_COMPONENT,
        approach,
        naming,
        1,
        "has no direction; give the one in which the tool is to point, such as 0 0 1 for down",
    )
    unit = approach / largest  # scaled first, so that the norm does not overflow
    unit = unit / np.linalg.norm(unit, axis=0)
    return IkTargets(p_R_from_N(position_m.T).T if frame == "rnav" else position_m, unit)


def _refuse(wrong: NDArray[np.bool_], values: Array, naming: TargetLabel, which: int, complaint: str) -> None:
    if not wrong.any():
        return
    first = int(np.argmax(wrong))
    numbers = format_numbers(tuple(float(value) for value in values[:, first]))
    raise BadRequest(f"{naming(first)[which]}: {numbers} {complaint}")


def read_targets(path: Path, frame: str) -> IkTargets:
    """Read the targets of a file.

    An .npz file holds arrays `position_m` and `approach`, shape (n, 3). A Parquet file has one column for
    each component.

    Raises:
        BadRequest: The file cannot be read, an array or column is missing, or a target is wrong.
    """
    suffix = path.suffix.lower()
    if suffix not in BATCH_SUFFIXES:
        raise BadRequest(f"batch {path}: its name must end in {' or '.join(BATCH_SUFFIXES)}")
    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe could block forever
        raise BadRequest(f"batch {path}: is not a regular file")
    with _read_errors(path):
        position, approach = _from_npz(path) if suffix == ".npz" else _from_parquet(path)
    if position.shape[1] != approach.shape[1]:
        raise BadRequest(
            f"batch {path}: there are {position.shape[1]} positions and {approach.shape[1]} approaches"
        )
    if position.shape[1] == 0:
        raise BadRequest(f"batch {path}: there is no target in it; give at least one")
    names = (
        ("position_m", "approach")
        if suffix == ".npz"
        else (", ".join(POSITION_COLUMNS), ", ".join(APPROACH_COLUMNS))
    )

    def naming(row: int) -> tuple[str, str]:
        where = f"batch {path}: row {row} (the first is 0): "
        return where + names[0], where + names[1]

    return make_targets(position, approach, frame, naming)


@contextmanager
def _read_errors(path: Path) -> Iterator[None]:
    """Convert errors of the readers, from damaged or foreign files, to one sentence."""
    kind = "a NumPy .npz file" if path.suffix.lower() == ".npz" else "a Parquet file"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # old file formats raise warnings
            yield
    except BadRequest:
        raise
    except MemoryError as error:
        raise BadRequest(f"batch {path}: is too large for the memory; give it in parts") from error
    except OSError as error:
        if error.strerror is None:  # raised by a reader of the format, not by the system
            raise BadRequest(f"batch {path}: {describe_bad_table(error, kind)}") from error
        raise BadRequest(f"batch {path}: cannot be read ({error.strerror})") from error
    except Exception as error:  # damaged headers raise errors of any kind
        raise BadRequest(f"batch {path}: {describe_bad_table(error, kind)}") from error


def _from_npz(path: Path) -> tuple[Array, Array]:
    """Read positions and approaches, shape (3, n) each."""
    with path.open("rb") as file:
        if file.read(len(ZIP_MAGIC)) != ZIP_MAGIC or not zipfile.is_zipfile(file):
            raise BadRequest(f"batch {path}: is not a NumPy .npz file, or only a part of one")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            missing = [name for name in ("position_m", "approach") if name not in arrays.files]
            if missing:
                raise BadRequest(
                    f"batch {path}: there is no array {' and no '.join(missing)}; "
                    "it must hold position_m (n, 3) and approach (n, 3), it holds "
                    f"{_list_names(arrays.files)}"
                )
            return _three_rows(path, "position_m", arrays["position_m"]), _three_rows(
                path, "approach", arrays["approach"]
            )


def _three_rows(path: Path, name: str, values: object) -> Array:
    """Check an array (n, 3) of real numbers; return it as (3, n)."""
    if not isinstance(values, np.ndarray):
        raise BadRequest(f"batch {path}: {name} is not an array")
    if values.ndim != 2 or values.shape[1] != 3:
        raise BadRequest(f"batch {path}: {name} has the shape {values.shape}, not (n, 3)")
    if values.dtype.kind not in "fiu":
        raise BadRequest(f"batch {path}: {name} holds {values.dtype}, not real numbers")
    with np.errstate(over="ignore"):  # wider number types may overflow
        return np.ascontiguousarray(values.T, dtype=np.float64)


def _from_parquet(path: Path) -> tuple[Array, Array]:
    """Read positions and approaches, shape (3, n) each; null becomes NaN."""
    from pyarrow import parquet, types

    with path.open("rb") as source, parquet.ParquetFile(source, page_checksum_verification=True) as file:
        column_names = file.schema_arrow.names
        missing = [name for name in (*POSITION_COLUMNS, *APPROACH_COLUMNS) if column_names.count(name) != 1]
        if missing:
            raise BadRequest(
                f"batch {path}: there must be one column {' and one '.join(missing)}; it has "
                f"{_list_names(column_names)}"
            )
        table = file.read(columns=[*POSITION_COLUMNS, *APPROACH_COLUMNS])
    for column in table.schema:
        if not types.is_floating(column.type) and not types.is_integer(column.type):
            raise BadRequest(f"batch {path}: {column.name} holds {column.type}, not real numbers")
    position, approach = (
        np.array([table.column(name).to_numpy() for name in names], dtype=np.float64)
        for names in (POSITION_COLUMNS, APPROACH_COLUMNS)
    )
    return position, approach


def _list_names(names: list[str]) -> str:
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "nothing"
