"""Records of arrays with the targets on their last axis: some of the targets, several records, more slots."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record")


def record_arrays(record: Any) -> tuple[NDArray[Any], ...]:
    """The arrays of a record."""
    return tuple(getattr(record, field.name) for field in fields(record))


def select_targets(record: Record, where: Any) -> Record:
    """A record of arrays (..., n) at some of the targets."""
    return type(record)(*(values[..., where] for values in record_arrays(record)))


def concatenate_records(parts: Sequence[Record]) -> Record:
    """Records of arrays (..., n), one after the other."""
    if len(parts) == 1:
        return parts[0]
    columns = zip(*(record_arrays(part) for part in parts), strict=True)
    return type(parts[0])(*(np.concatenate(column, axis=-1) for column in columns))


def replace_targets(record: Record, where: NDArray[np.intp], others: Record) -> Record:
    """A record of arrays (..., n), with others (..., k) in the place of the targets `where`."""
    columns = [values.copy() for values in record_arrays(record)]
    for values, new in zip(columns, record_arrays(others), strict=True):
        values[..., where] = new
    return type(record)(*columns)


def pad_slots(values: NDArray[Any], slots: int, fill: float) -> NDArray[Any]:
    """Values (..., slots, n) with at least so many slots, the new ones filled."""
    more = slots - values.shape[-2]
    if more <= 0:
        return values
    filler = np.full((*values.shape[:-2], more, values.shape[-1]), fill, values.dtype)
    return np.concatenate([values, filler], axis=-2)
