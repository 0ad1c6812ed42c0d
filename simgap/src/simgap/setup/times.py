"""Times and motions of a log without a robot file, from names and from where the time begins anew."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files.columns import ColumnInfo, Kind, median_rate_Hz, say_repeats
from simgap.files.log_file import LogFile
from simgap.setup.column_names import MOTIONS, REPEATS, TIMES, parse_name, split_words
from simgap.units import UNITS

USUAL_Hz: Final = 100.0
"""Logs of robots have 3 to 3000 samples a second: a factor of 1000, as between units of time, so that one
unit fits."""
NANOSECONDS: Final = frozenset(("nanosec", "nanoseconds", "nsec", "nsecs"))
MAX_MOTIONS: Final = 0.2
"""Largest share of distinct values in a column that names motions: a motion has several samples."""


@dataclass(frozen=True, slots=True)
class Times:
    """Times of a log, and how it is cut into motions."""

    column: str
    """Empty if the file knows its times itself."""
    unit: str
    motions: tuple[str, ...]
    """Columns that name the motions; empty: the whole file is one, or the file knows them itself."""
    repeat: str
    """Column that is the same in motions that repeat one another; empty: none is known."""
    rate_Hz: float
    reasons: dict[str, str]
    """Reasons by key of the robot file: "time" and "motion"."""


def find_times(log: LogFile, columns: Sequence[ColumnInfo]) -> Times:
    """Find the times of a log and the columns that name its motions; RobotError if there are none."""
    rates = [one.rate_Hz for one in columns if one.rate_Hz and one.kind == "number"]
    if rates:  # the file knows its times
        return Times("", "s", (), "", float(np.median(rates)), {})
    kinds = {one.name: one.kind for one in columns if _is_time(one, "number", "time")}
    clocks = {name: log.numbers(name).value for name in kinds}
    going = [name for name, clock in clocks.items() if 2 * np.sum(np.diff(clock) > 0.0) > clock.size - 1]
    if not going:
        raise RobotError(f"{log.path}: {_why_no_clock(columns)}")
    if len(going) < len(kinds) and any(set(split_words(one)) & NANOSECONDS for one in going):
        raise RobotError(
            f"{log.path}: the time is in two columns, {' and '.join(kinds)}; write one, "
            "seconds plus 1e-9 nanoseconds"
        )
    name = min(going, key=len)
    clock, rate = clocks[name], median_rate_Hz(clocks[name])
    assert rate is not None
    unit, said = _time_unit(name, kinds[name], rate)
    motions, repeat, why = _find_motions(log, columns, name, clock)
    reasons = {"time": said} | ({"motion": why} if motions else {})
    return Times(name, unit, motions, repeat, rate / UNITS[unit].factor, reasons)


def _is_time(one: ColumnInfo, *kinds: Kind) -> bool:
    return one.kind in kinds and bool(set(split_words(one.name)) & set(TIMES))


def _why_no_clock(columns: Sequence[ColumnInfo]) -> str:
    """Return why no column is taken for the time, and what would be right."""
    clock = next((one for one in columns if _is_time(one, "number", "time")), None)
    if clock is not None and clock.n_samples < 2:
        return f"the time {clock.name!r} has {clock.n_samples} value; a log needs several"
    if clock is not None:
        return (
            f"the time {clock.name!r} stands still in most rows: are rows twice, or has it too few digits, "
            "as seconds since 1970 in single precision?"
        )
    text = next((one.name for one in columns if _is_time(one, "text")), "")
    if text:
        return (
            f"the time {text!r} holds texts: remove rows that are no numbers, such as one of units, or write "
            "seconds"
        )
    if all(one.name.startswith("column[") for one in columns):
        return "its columns have no names; write them in the first row, such as t and position_elbow"
    there = ", ".join(one.name for one in columns)
    return f"no column is a time by its name (such as t, time_s or timestamp); it has {there}"


def _time_unit(name: str, kind: Kind, rate: float) -> tuple[str, str]:
    """Return the unit of a clock, of its name or that in which its rate is most usual, and why."""
    if kind == "time":
        return "s", "dates are read as seconds"
    rates = {unit: rate / UNITS[unit].factor for unit in ("s", "ms", "us", "ns")}
    if (named := parse_name(name, ()).unit) in rates:
        return named, f"its name ends in {named}"
    unit = min(rates, key=lambda one: abs(math.log(rates[one] / USUAL_Hz)))
    return unit, f"so that the log has {rates[unit]:.4g} samples a second"


def _find_motions(
    log: LogFile, columns: Sequence[ColumnInfo], time: str, clock: Array
) -> tuple[tuple[str, ...], str, str]:
    """Return the columns whose values together name a motion, that of their repeats, and why."""
    restarts = np.flatnonzero(np.diff(clock) <= 0.0) + 1
    texts = {}
    for one in columns:
        is_label = one.kind == "text" or (one.kind in ("number", "flag") and one.name != time)
        if is_label and one.n_samples == clock.size:
            text = log.texts(one.name)
            n_values = np.unique(text).size
            if 1 < n_values <= max(2.0, MAX_MOTIONS * clock.size):
                texts[one.name] = np.flatnonzero(text[1:] != text[:-1]) + 1
    by_name = [name for name in texts if set(split_words(name)) & set(MOTIONS)]
    if not restarts.size:
        name = min(by_name, key=lambda one: texts[one].size, default="")
        same = [one for one in texts if set(split_words(one)) & REPEATS]
        repeat = next((one for one in same if name and np.isin(texts[one], texts[name]).all()), "")
        return ((name,), repeat, "by its name") if name else ((), "", "")
    inside = {name: at for name, at in texts.items() if np.isin(at, restarts).all() and at.size}
    repeat = next((name for name in inside if set(split_words(name)) & REPEATS), "")
    inside.pop(repeat, None)
    ranked = sorted(inside, key=lambda name: (-inside[name].size, name not in by_name, len(name)))
    chosen: list[str] = []
    left = restarts
    for name in ranked:
        if np.isin(left, inside[name]).any():
            chosen.append(name)
            left = np.setdiff1d(left, inside[name])
    if left.size:
        row = int(left[0]) + 1
        if np.all(clock[left] == clock[left - 1]):
            n_rows = int(np.sum(np.diff(clock) == 0.0))
            raise RobotError(f"{log.path}: the time {time!r} {say_repeats(n_rows, row)}")
        raise RobotError(
            f"{log.path}: the time {time!r} does not increase at row {row}, and no column says that a motion "
            "begins there; add a column that names the motions, or give each motion a file of its own"
        )
    return tuple(chosen), repeat, f"where the time begins anew ({restarts.size} times), it changes"
