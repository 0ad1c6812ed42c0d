"""Parquet writer of inverse-kinematics results: one row for each target and each of its branches."""

import json
from typing import Any, BinaryIO, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from fsw.kinematics.branches import slot_name
from fsw.kinematics.ik import BranchVerdict, IkResult
from ground.ik.tally import JOINT_NAMES, VERDICT_NAMES

NAME_TYPE: Final = pa.dictionary(pa.int8(), pa.string())


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
        """Write the results of the next targets, shape (S, n); values that do not apply are null."""
        slots, count = result.verdict.shape
        target, slot = np.nonzero(result.verdict.T != BranchVerdict.ABSENT)
        verdict, excess = result.verdict[slot, target], result.excess[slot, target]
        outside, unreachable = verdict == BranchVerdict.OUTSIDE_LIMITS, verdict == BranchVerdict.OUT_OF_REACH
        columns = [
            pa.array(self._next + target),
            _name_column(slot, [slot_name(k) for k in range(slots)]),
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
