"""Records of arrays with the targets on their last axis: select and concatenate."""

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
