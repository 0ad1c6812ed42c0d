"""Answers of a batch as a Parquet table: one row for each target and branch that it has."""

import json
from typing import Any, BinaryIO, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from fsw.kinematics.branches import slot_name
from fsw.kinematics.ik import BranchVerdict, IkResult
from ground.ik.names import JOINTS, VERDICTS

NAMES: Final = pa.dictionary(pa.int8(), pa.string())


class ParquetWriter:
    """A row group for each part of the batch."""

    def __init__(self, file: BinaryIO, about: dict[str, Any]) -> None:
        schema = pa.schema(
            [
                ("target", pa.int64()),
                ("branch", NAMES),
                ("verdict", NAMES),
                *((f"{joint}_rad", pa.float64()) for joint in JOINTS),
                ("limiting_joint", NAMES),
                ("beyond_limit_rad", pa.float64()),
                ("out_of_reach_m", pa.float64()),
                ("forward_error", pa.float64()),
            ],
            metadata={"about": json.dumps(about)},
        )
        self._schema = schema
        self._writer = parquet.ParquetWriter(file, schema, write_page_checksum=True)
        self._next = 0

    def add(self, answers: IkResult) -> None:
        """Write the answers of the next targets, (S, n); what a target has not is null."""
        slots, count = answers.verdict.shape
        target, slot = np.nonzero(answers.verdict.T != BranchVerdict.ABSENT)
        verdict, excess = answers.verdict[slot, target], answers.excess[slot, target]
        outside, away = verdict == BranchVerdict.OUTSIDE_LIMITS, verdict == BranchVerdict.OUT_OF_REACH
        columns = [
            pa.array(self._next + target),
            _named(slot, [slot_name(k) for k in range(slots)]),
            _named(verdict, VERDICTS),
            *(_numbers(angle[slot, target]) for angle in answers.output_rad),
            _named(answers.joint[slot, target], JOINTS, ~outside),
            _numbers(np.where(outside, excess, np.nan)),
            _numbers(np.where(away, excess, np.nan)),
            _numbers(answers.error[slot, target]),
        ]
        self._writer.write_table(pa.table(columns, schema=self._schema))
        self._next += count

    def close(self) -> None:
        """Write what belongs at the end."""
        self._writer.close()


def _named(
    numbers: NDArray[np.int64], names: list[str] | tuple[str, ...], absent: NDArray[np.bool_] | None = None
) -> Any:
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int8), mask=absent), list(names))


def _numbers(values: NDArray[np.float64]) -> Any:
    return pa.array(values, from_pandas=True)  # NaN is null
