"""Files of batches: read targets from tables, and write their results part by part."""

import json
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, IkResult
from marsarm.ik.request import BATCH_SUFFIXES
from marsarm.ik.targets import JOINT_NAMES, VERDICT_NAMES, IkTargets, make_targets
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write
from simgap.files.log_file import open_whole

POSITION_COLUMNS: Final = ("position_x_m", "position_y_m", "position_z_m")
APPROACH_COLUMNS: Final = ("approach_x", "approach_y", "approach_z")
ARRAYS: Final = ("position_m", "approach")
NAMES: Final = {
    ".npz": tuple(tuple(f"{array}[{k}]" for k in range(3)) for array in ARRAYS),
    ".parquet": (POSITION_COLUMNS, APPROACH_COLUMNS),
}
"""Columns of a file of targets by its suffix: of the positions, and of the approaches."""


def read_targets(path: Path, frame: str) -> IkTargets:
    """Read the targets of a file; BadRequest if it, an array, a column or a target is missing or wrong.

    An .npz file holds arrays `position_m` and `approach`, shape (n, 3). A Parquet file has one column for
    each component.
    """
    if path.suffix.lower() not in BATCH_SUFFIXES:
        raise BadRequest(f"batch {path}: its name must end in {' or '.join(BATCH_SUFFIXES)}")
    names = NAMES[path.suffix.lower()]
    try:
        log = open_whole(path)
        there = [one.name for one in log.describe()]
        _check_columns(path, there, names)
        values = [[log.numbers(name).value for name in three] for three in names]
    except RobotError as error:
        raise BadRequest(f"batch {error}") from error
    position, approach = (np.array(three) for three in values)
    if position.shape != approach.shape:
        raise BadRequest(
            f"batch {path}: there are {position.shape[1]} positions and {approach.shape[1]} approaches"
        )
    labels = ARRAYS if path.suffix.lower() == ".npz" else [", ".join(three) for three in names]

    def naming(row: int) -> tuple[str, str]:
        where = f"batch {path}: row {row} (the first is 0): "
        return where + labels[0], where + labels[1]

    return make_targets(position, approach, frame, naming)


def _check_columns(path: Path, there: Sequence[str], names: Sequence[Sequence[str]]) -> None:
    """Check that all components are there, and no fourth one of an array."""
    missing = [name for three in names for name in three if name not in there]
    if missing or any(f"{array}[3]" in there for array in ARRAYS):
        form = ", each of shape (n, 3)" if names == NAMES[".npz"] else ""
        wanted = ARRAYS if form else (*POSITION_COLUMNS, *APPROACH_COLUMNS)
        raise BadRequest(
            f"batch {path}: it must hold {', '.join(wanted)}{form}; it has {', '.join(there[:20])}"
        )


NO_JOINT: Final = -1
NAME_TYPE: Final = pa.dictionary(pa.int8(), pa.string())

FIELDS: Final[dict[str, tuple[type, tuple[int, ...]]]] = {
    "output_rad": (np.float64, (8, 5)),
    "verdict": (np.int8, (8,)),
    "joint": (np.int8, (8,)),
    "excess": (np.float64, (8,)),
    "forward_error": (np.float64, (8,)),
}
"""Arrays (n, 8, ...) of an .npz file: type, and shape of the results of one target."""


class BatchWriter(Protocol):
    """Protocol of writers that take the results of a batch part by part."""

    def add(self, result: IkResult) -> None:
        """Write the results of the next targets, shape (8, n)."""


@contextmanager
def open_writer(path: Path, about: dict[str, Any]) -> Iterator[BatchWriter]:
    """Open a writer by suffix; the file appears if the block completes, BadOutput if it cannot be written."""
    with atomic_write(path, "out") as file, ExitStack() as stack:
        if path.suffix.lower() == ".npz":
            spools: dict[str, IO[bytes]] = {}
            for name in FIELDS:
                spools[name] = stack.enter_context(tempfile.TemporaryFile(dir=path.parent))
            spooled = NpzWriter(spools)
            yield spooled
            spooled.pack(file, about)
        else:
            yield stack.enter_context(closing(ParquetWriter(file, about)))


class NpzWriter:
    """Writer of an .npz file.

    The format stores one array after another, so parts wait in temporary files.
    """

    def __init__(self, spools: dict[str, IO[bytes]]) -> None:
        self._spools = spools
        self._targets = 0

    def add(self, result: IkResult) -> None:
        """Write the results of the next targets, shape (8, n)."""
        self._targets += result.verdict.shape[1]
        outside = result.verdict == BranchVerdict.OUTSIDE_LIMITS
        arrays = {
            "output_rad": result.output_rad.transpose(2, 1, 0),
            "verdict": result.verdict.T,
            "joint": np.where(outside, result.joint, NO_JOINT).T,
            "excess": result.excess.T,
            "forward_error": result.error.T,
        }
        for name, (dtype, _) in FIELDS.items():
            self._spools[name].write(np.ascontiguousarray(arrays[name], dtype=dtype).tobytes())

    def pack(self, file: BinaryIO, about: dict[str, Any]) -> None:
        """Assemble the file."""
        names = {
            "branch_names": np.array(BRANCHES),
            "verdict_names": np.array(VERDICT_NAMES),
            "joint_names": np.array(JOINT_NAMES),
            "about": np.array(json.dumps(about)),
        }
        with zipfile.ZipFile(file, "w") as archive:
            for name in FIELDS:
                with archive.open(_entry(name), "w", force_zip64=True) as member:
                    self._copy(name, member)
            for name, values in names.items():
                with archive.open(_entry(name), "w") as member:
                    np.lib.format.write_array(member, values, allow_pickle=False)

    def _copy(self, name: str, member: Any) -> None:
        dtype, shape = FIELDS[name]
        header = {
            "descr": np.lib.format.dtype_to_descr(np.dtype(dtype)),
            "fortran_order": False,
            "shape": (self._targets, *shape),
        }
        np.lib.format.write_array_header_1_0(member, header)
        spool = self._spools[name]
        spool.seek(0)
        shutil.copyfileobj(spool, member)


def _entry(name: str) -> zipfile.ZipInfo:
    """Create an entry without time stamp, so that equal results give equal bytes."""
    return zipfile.ZipInfo(f"{name}.npy")


class ParquetWriter:
    """Writer of a Parquet file with one row group for each part of the batch."""

    def __init__(self, file: BinaryIO, about: dict[str, Any]) -> None:
        schema = pa.schema(
            [
                ("target", pa.int64()),
                ("branch", NAME_TYPE),
                ("verdict", NAME_TYPE),
                *((f"{joint}_rad", pa.float64()) for joint in JOINT_NAMES),
                ("limiting_joint", NAME_TYPE),
                ("beyond_limit_rad", pa.float64()),
                ("out_of_reach_m", pa.float64()),
                ("forward_error", pa.float64()),
            ],
            metadata={"about": json.dumps(about)},
        )
        self._schema = schema
        self._writer = parquet.ParquetWriter(file, schema, write_page_checksum=True)
        self._next = 0

    def add(self, result: IkResult) -> None:
        """Write the results of the next targets, shape (8, n); values that do not apply are null."""
        count = result.verdict.shape[1]
        target, slot = np.indices((count, len(BRANCHES))).reshape(2, -1)
        verdict, excess = result.verdict[slot, target], result.excess[slot, target]
        outside, unreachable = verdict == BranchVerdict.OUTSIDE_LIMITS, verdict == BranchVerdict.OUT_OF_REACH
        columns = [
            pa.array(self._next + target),
            _name_column(slot, BRANCHES),
            _name_column(verdict, VERDICT_NAMES),
            *(_number_column(angle[slot, target]) for angle in result.output_rad),
            _name_column(result.joint[slot, target], JOINT_NAMES, ~outside),
            _number_column(np.where(outside, excess, np.nan)),
            _number_column(np.where(unreachable, excess, np.nan)),
            _number_column(result.error[slot, target]),
        ]
        self._writer.write_table(pa.table(columns, schema=self._schema))
        self._next += count

    def close(self) -> None:
        """Write the footer of the file."""
        self._writer.close()


def _name_column(
    numbers: NDArray[np.int64], names: list[str] | tuple[str, ...], absent: NDArray[np.bool_] | None = None
) -> Any:
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int8), mask=absent), list(names))


def _number_column(values: NDArray[np.float64]) -> Any:
    return pa.array(values, from_pandas=True)  # NaN is null
