"""Files of batches: read targets from tables, and write their results part by part."""

import json
import os
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet, types

from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, IkResult
from fsw.kinematics.transforms import Array
from marsarm.common.requests import describe_bad_table
from marsarm.ik.request import BATCH_SUFFIXES
from marsarm.ik.targets import JOINT_NAMES, VERDICT_NAMES, IkTargets, make_targets
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write

ZIP_MAGIC: Final = b"PK\x03\x04"
POSITION_COLUMNS: Final = ("position_x_m", "position_y_m", "position_z_m")
APPROACH_COLUMNS: Final = ("approach_x", "approach_y", "approach_z")


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
    """Open a writer for the suffix of `path`; the file appears only if the block completes without error.

    Raises:
        BadOutput: The file cannot be written.
    """
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
