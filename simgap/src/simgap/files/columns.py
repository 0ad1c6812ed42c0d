"""Columns of a log: their numbers, and whether those that the robot file names are there."""

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Array, Flags
from simgap.common.errors import RobotError

N_NAMES: Final = 8
"""Number of columns that an error lists."""


@dataclass(frozen=True, slots=True)
class Column:
    """Numbers of a column, where it has any."""

    value: Array
    """(n,)."""
    is_present: Flags | None = None
    """False where a cell is empty, (n,); None: no cell is."""
    time_s: Array | None = None
    """Times of the messages, (n,), in a format where each column has its own; else None."""


class LogFile(Protocol):
    """Log file that is open for reading, one column at a time."""

    @property
    def path(self) -> Path:
        """Path of the file."""
        ...

    def numbers(self, name: str) -> Column:
        """Return the numbers of a column."""
        ...

    def texts(self, name: str) -> NDArray[np.str_]:
        """Return a column as text, (n,)."""
        ...


def check_columns(path: Path, wanted: Sequence[str], there: Sequence[str]) -> None:
    """Check that a log has the columns that the robot file names.

    Raises:
        RobotError: one is missing; the text names the nearest, or those that there are.
    """
    for name in wanted:
        if name not in there:
            near = get_close_matches(name, there, 1)
            listed = ", ".join([*there[:N_NAMES], *([".."] if len(there) > N_NAMES else [])])
            listed = " ".join(listed.split())
            hint = f"did you mean {near[0]!r}?" if near else f"it has {listed or 'none'}"
            raise RobotError(f"{path}: has no column {name!r}, which the robot file names; {hint}")
        if there.count(name) > 1:
            raise RobotError(f"{path}: has {there.count(name)} columns {name!r}; give each its own name")
