"""Columns of a log: their names, their numbers, what is told of them, and pauses in which nothing is logged.

All formats share one grammar of names: `NAME`, `NAME.field` for a field, `NAME[2]` for a place in a list, and
`NAME[elbow]` for a name in a list whose items have names.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Final, Literal

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.common.console import pluralize
from simgap.common.errors import RobotError

N_NAMES: Final = 8
"""Number of columns that an error lists."""
MAX_LISTED: Final = 64
"""Longest list whose items are listed as columns: robots have fewer joints, pictures more points."""
STEP: Final = re.compile(r"\.[^.\[\]]+|\[[^\[\]]+\]")
Kind = Literal["number", "flag", "time", "text", "other"]
"""Content of a column; a time is a date, which is read as seconds."""


@dataclass(frozen=True, slots=True)
class Column:
    """Numbers of a column, where it has any."""

    value: Array
    """(n,)."""
    is_present: Flags | None = None
    """False where a cell is empty, (n,); None: no cell is."""
    time_s: Array | None = None
    """Times of the messages, (n,), in a format where each column has its own; else None."""
    message: Integers | None = None
    """Numbers of the messages in their topic, (n,), from 1; None in a table."""

    @property
    def is_absent(self) -> bool:
        """True if the column never has a number, as where a driver fills a field with NaN."""
        value = self.value if self.is_present is None else self.value[self.is_present]
        return bool(np.all(np.isnan(value)))


@dataclass(frozen=True, slots=True)
class ColumnInfo:
    """Column of a log, as it is listed."""

    name: str
    """Name that a robot file may give it."""
    kind: Kind
    n_samples: int
    """Cells or messages that have a value; NaN is none."""
    rate_Hz: float | None = None
    """Samples a second; None if the file does not know their times."""
    lowest: float | None = None
    """Smallest finite number; None for a text, or without one."""
    highest: float | None = None
    unit: str = ""
    """Unit of the logged values; empty if the file does not know it."""


def split_name(name: str, known: Iterable[str]) -> tuple[str, tuple[str, ...]] | None:
    """Divide a name into the longest known one that begins it and steps `.field`, `[2]`, `[elbow]`."""
    fits = [one for one in known if name == one or name.startswith((f"{one}.", f"{one}["))]
    for base in sorted(fits, key=len, reverse=True):
        rest = name[len(base) :]
        steps = STEP.findall(rest)
        if "".join(steps) == rest:
            return base, tuple(steps)
    return None


def place_in_list(step: str, names: Sequence[str] | None) -> int | None:
    """Return the place that a step `[2]` or `[elbow]` means; None if there is no such name.

    A name counts first: drivers name motors by numbers.
    """
    inner = step[1:-1].strip()
    if names is not None and inner in names:
        return names.index(inner)
    return int(inner) if inner.isdecimal() else None


def missing_column(path: Path, name: str, there: Sequence[str]) -> RobotError:
    """Return the error for a column that is not there; it names the nearest, or those that there are."""
    hint = hint_at(name, there, "it has")
    return RobotError(f"{path}: has no column {name!r}, which robot file or mapping names; {hint}")


def hint_at(name: str, there: Sequence[str], words: str) -> str:
    """Ask whether the nearest of some names was meant, else list the first of them after some words."""
    near = get_close_matches(name, there, 1)
    listed = ", ".join([*there[:N_NAMES], *([".."] if len(there) > N_NAMES else [])])
    return f"did you mean {near[0]!r}?" if near else f"{words} {' '.join(listed.split()) or 'none'}"


def describe_numbers(
    name: str, column: Column, kind: Kind, unit: str = "", rate_Hz: float | None = None
) -> ColumnInfo:
    """Describe a column of numbers."""
    value = column.value if column.is_present is None else column.value[column.is_present]
    n = int(np.count_nonzero(~np.isnan(value)))
    finite = value[np.isfinite(value)]
    lowest, highest = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    if column.time_s is not None:
        rate_Hz = median_rate_Hz(column.time_s)
    return ColumnInfo(name, kind, n, rate_Hz, lowest, highest, unit)


def say_disorder(time_s: Array, rows: Integers | None = None) -> str:
    """Say where times (n,), of these rows from 1, do not increase, and what would be right; else nothing."""
    step_s = np.diff(time_s)
    back = np.flatnonzero(step_s <= 0.0)
    if not back.size:
        return ""
    row = int(back[0]) + 2 if rows is None else int(rows[back[0] + 1])
    if 2 * np.sum(step_s == 0.0) > step_s.size:
        return (
            "stands still in most rows: are rows twice, or has it too few digits, as seconds since 1970 in "
            "single precision?"
        )
    if np.all(step_s[back] == 0.0):
        return say_repeats(back.size, row)
    before, after = time_s[back[0]], time_s[back[0] + 1]
    return (
        f"runs backwards from {before:.10g} s to {after:.10g} s in row {row}; sort the rows, or name the "
        "columns of a motion"
    )


def say_repeats(n_rows: int, row: int) -> str:
    """Say how many rows repeat the time of the row before them, and which is the first, from 1."""
    return (
        f"repeats: {pluralize(n_rows, 'row')} {'have' if n_rows > 1 else 'has'} the time of the row before, "
        f"the first is row {row}; remove one of each two, or give it its own time"
    )


def median_rate_Hz(time_s: Array) -> float | None:
    """Return the rate by the median of the periods; None if it is not known."""
    periods_s = np.diff(time_s)
    periods_s = periods_s[np.isfinite(periods_s) & (periods_s > 0.0)]
    return 1.0 / float(np.median(periods_s)) if periods_s.size else None


GAP: Final = 2.5
"""A row is missing where a period exceeds this many medians: two rows and half a period of jitter."""
SETTLING_S: Final = 0.3
"""Time in which the position loop of an arm settles, or less. A gap as long, or a step of the clock, is worth
a remark: a joint settles in it unseen."""
MAX_WINDOWS: Final = 8
"""Windows that a sentence lists: more are none."""
ROUNDING_s: Final = 1e-5
"""Rounding of times by which a window is not wider."""


class LongGap(RobotError):
    """A motion has a gap that no simulation should cross."""

    def __init__(self, text: str, windows_s: dict[str, list[float]]) -> None:
        """Keep the windows that cut the log there; none if it has several motions."""
        super().__init__(text)
        self.windows_s = windows_s


def find_pauses(time_s: Array, period_s: float) -> list[tuple[float, float]]:
    """Find pauses in increasing times (n,) of a usual period: last time before, first time after [s]."""
    long = np.flatnonzero(np.diff(time_s) > max(SETTLING_S, GAP * period_s))
    return [(float(time_s[k]), float(time_s[k + 1])) for k in long]


def cut_at_pauses(
    begin_s: float, pauses: Sequence[tuple[float, float]] | Array, end_s: float
) -> dict[str, list[float]]:
    """Return the windows between pauses, as `motion.windows_s` of a robot file: name -> start and end.

    They end at whole hundredths of a second, which are outwards of their rows. Parts that are too short for a
    joint to settle are left out, unless all are such.
    """
    ends_s = [(begin_s, begin_s), *pauses, (end_s, end_s)]
    parts = [(one[1], two[0]) for one, two in pairwise(ends_s)]
    parts = [(low, high) for low, high in parts if high - low >= SETTLING_S] or parts
    return {
        f"part{k}": [math.floor((low + ROUNDING_s) * 100) / 100, math.ceil((high - ROUNDING_s) * 100) / 100]
        for k, (low, high) in enumerate(parts, 1)
    }


def windows_text(windows_s: Mapping[str, Sequence[float]]) -> str:
    """Return windows as the line of a robot file."""
    shown = (f"{name} = [{low:.10g}, {high:.10g}]" for name, (low, high) in windows_s.items())
    return f"windows_s = {{ {', '.join(shown)} }}"
