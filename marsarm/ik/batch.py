"""Files of batches: read targets, and write their results part by part."""

import json
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, Final

import numpy as np

from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, IkResult
from marsarm.ik.request import BATCH_SUFFIXES
from marsarm.ik.targets import JOINT_NAMES, VERDICT_NAMES, IkTargets, make_targets
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write
from simgap.files.log_file import open_whole

ARRAYS: Final = ("position_m", "approach")


def read_targets(path: Path, frame: str) -> IkTargets:
    """Read the targets of an .npz file; BadRequest if it, an array or a target is missing or wrong."""
    if path.suffix.lower() not in BATCH_SUFFIXES:
        raise BadRequest(f"batch {path}: its name must end in {BATCH_SUFFIXES[0]}")
    names = [[f"{array}[{k}]" for k in range(3)] for array in ARRAYS]
    try:
        log = open_whole(path)
        _check_arrays(path, [one.name for one in log.describe()], names)
        values = [[log.numbers(name).value for name in three] for three in names]
    except RobotError as error:
        raise BadRequest(f"batch {error}") from error
    position, approach = (np.array(three) for three in values)
    if position.shape != approach.shape:
        raise BadRequest(
            f"batch {path}: there are {position.shape[1]} positions and {approach.shape[1]} approaches"
        )

    def naming(row: int) -> tuple[str, str]:
        where = f"batch {path}: row {row} (the first is 0): "
        return where + ARRAYS[0], where + ARRAYS[1]

    return make_targets(position, approach, frame, naming)


def _check_arrays(path: Path, there: Sequence[str], names: Sequence[Sequence[str]]) -> None:
    """Check that all components are there, and no fourth one of an array."""
    missing = [name for three in names for name in three if name not in there]
    if missing or any(f"{array}[3]" in there for array in ARRAYS):
        raise BadRequest(
            f"batch {path}: it must hold {', '.join(ARRAYS)}, each of shape (n, 3); "
            f"it has {', '.join(there[:20])}"
        )


NO_JOINT: Final = -1

FIELDS: Final[dict[str, tuple[type, tuple[int, ...]]]] = {
    "output_rad": (np.float64, (8, 5)),
    "verdict": (np.int8, (8,)),
    "joint": (np.int8, (8,)),
    "excess": (np.float64, (8,)),
    "forward_error": (np.float64, (8,)),
}
"""Arrays (n, 8, ...) of an .npz file: type, and shape of the results of one target."""


@contextmanager
def open_writer(path: Path, about: dict[str, Any]) -> Iterator["NpzWriter"]:
    """Open a writer; the file appears if the block completes, BadOutput if it cannot be written."""
    with atomic_write(path, "out") as file, ExitStack() as stack:
        spools: dict[str, IO[bytes]] = {}
        for name in FIELDS:
            spools[name] = stack.enter_context(tempfile.TemporaryFile(dir=path.parent))
        writer = NpzWriter(spools)
        yield writer
        writer.pack(file, about)


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
