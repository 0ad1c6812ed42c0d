"""Records of arrays with the targets on their last axis: select, concatenate, replace and pad."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record")


def record_arrays(record: Any) -> tuple[NDArray[Any], ...]:
    """Return the arrays of a record.

    Args:
        record: Data class of arrays.

    Returns:
        Its arrays, in the order of the fields.
    """
    return tuple(getattr(record, field.name) for field in fields(record))


def select_targets(record: Record, where: Any) -> Record:
    """Select some targets of a record.

    Args:
        record: Data class of arrays, shape (..., n).
        where: Index of the last axis.

    Returns:
        The record at these targets.
    """
    # an index alone leaves the values of a target next to each other, and all that follows is slower
    return type(record)(*(np.ascontiguousarray(values[..., where]) for values in record_arrays(record)))


def concatenate_records(parts: Sequence[Record]) -> Record:
    """Concatenate records along the last axis.

    Args:
        parts: Data classes of arrays, shape (..., n); at least one.

    Returns:
        One record with the targets of all parts in order.
    """
    if len(parts) == 1:
        return parts[0]
    columns = zip(*(record_arrays(part) for part in parts), strict=True)
    return type(parts[0])(*(np.concatenate(column, axis=-1) for column in columns))


def replace_targets(record: Record, where: NDArray[np.intp], others: Record) -> Record:
    """Replace some targets of a record.

    Args:
        record: Data class of arrays, shape (..., n).
        where: Target indices to replace, shape (k,).
        others: Record of the new values, shape (..., k).

    Returns:
        A copy of the record with the new values.
    """
    columns = [values.copy() for values in record_arrays(record)]
    for values, new in zip(columns, record_arrays(others), strict=True):
        values[..., where] = new
    return type(record)(*columns)


def pad_slots(values: NDArray[Any], slots: int, fill: float) -> NDArray[Any]:
    """Pad an array to a least number of slots.

    Args:
        values: Values of any unit, shape (..., slots, n).
        slots: Least number of slots of the result.
        fill: Value of the new slots.

    Returns:
        The padded array, shape (..., slots, n).
    """
    more = slots - values.shape[-2]
    if more <= 0:
        return values
    filler = np.full((*values.shape[:-2], more, values.shape[-1]), fill, values.dtype)
    return np.concatenate([values, filler], axis=-2)
