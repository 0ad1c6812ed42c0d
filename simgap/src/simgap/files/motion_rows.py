"""Rows of a log file by motion, as checked signals in SI units at the joint, with counters unwrapped."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simgap.arrays import Array, Flags
from simgap.common.console import pluralize
from simgap.common.errors import RobotError
from simgap.files.columns import (
    MAX_WINDOWS,
    Column,
    LongGap,
    cut_at_pauses,
    find_pauses,
    say_disorder,
    windows_text,
)
from simgap.files.log_file import LogFile
from simgap.files.robot_file import JointTable, RobotFile, SignalColumn
from simgap.logs import Signal
from simgap.units import COUNTS, SHARES, UNITS, Quantity, find_unit

MAX_VALUE: Final = 1e9
"""Largest value in SI units: no angle, torque, current or voltage of a robot is as large."""
MAX_PERIOD_S: Final = 1.0
"""Longest mean period of positions: a controlled joint settles in less, so that nothing of it shows."""
SLOWEST: Final = 0.01
"""Least rate of positions in that of the controller. Logs have a hundredth of it to ten times as much: a
range of 1000, so that no other unit of time fits as well."""
FASTEST: Final = 10.0
TIMES: Final = ("s", "ms", "us", "ns")
"""Units that are mistaken for one another."""


ROUNDING_s: Final = 1e-6
"""Rounding of a time: seconds since 1970 as a double have steps of a quarter of it."""
NEEDED: Final = ("position", "command")
"""Signals that a log must have if the robot file names them; others may be absent."""
Pieces = list[tuple[Any, Array]]
"""Rows and times of each motion."""


class MotionRows:
    """A log file with its rows divided into motions."""

    def __init__(self, log: LogFile, file: RobotFile) -> None:
        """Divide the rows by the columns that name a motion, or by windows of time."""
        self.losses = list(log.losses)
        """Sentences about what could not be read."""
        self._log = log
        self._file = file
        self._time_column = file.time.column or log.time_column
        self._time_unit = file.time.unit if file.time.column else "s"
        self._clocks: dict[str, Array] = {}
        self._pieces: dict[str, Pieces] = {}
        self.names: tuple[str, ...] = (log.path.resolve().stem,)
        self._parts: list[Any] = [slice(None)]
        self._n_rows: int | None = None
        self._windows_s: list[tuple[float, float]] = []
        self._columns = file.motion.columns or [log.motion_column]
        if file.motion.windows_s:
            self.names = tuple(file.motion.windows_s)
            self._windows_s = [(start_s, end_s) for start_s, end_s in file.motion.windows_s.values()]
            self._parts *= len(self.names)
        elif any(self._columns):
            self._divide(self._columns)

    def _divide(self, columns: Sequence[str]) -> None:
        texts = [self._log.texts(name) for name in columns]
        joined, self._n_rows = texts[0], texts[0].size
        for text, name in zip(texts, columns, strict=True):
            self._check_length(text, name)
            if not (is_named := np.char.str_len(np.char.strip(text)) > 0).all():
                row = int(np.argmin(is_named)) + 1
                raise RobotError(f"{self._log.path}: column {name!r} is empty in row {row}; name the motion")
            joined = text if text is joined else np.char.add(np.char.add(joined, " "), text)
        names, first, number = np.unique(joined, return_index=True, return_inverse=True)
        order = np.argsort(first)
        self.names = tuple(str(names[k]) for k in order)
        self._parts = [_as_slice(np.flatnonzero(number == k)) for k in order]

    def _check_length(self, values: Any, name: str) -> None:
        """Refuse an array of another length than the column that names the motions."""
        if self._n_rows not in (None, values.size):
            raise RobotError(
                f"{self._log.path}: column {name!r} has {values.size} values, {self._columns[0]!r} has "
                f"{self._n_rows}; give both the same length"
            )

    def signals(
        self, key: str, one: SignalColumn, quantity: Quantity, table: JointTable
    ) -> list[Signal] | None:
        """Return a signal of a joint for each motion; None if it never has a number and is not needed.

        Values of a log before its first number are a loss: a driver had none yet.

        Raises:
            RobotError: a value is not finite, times do not increase, or a motion has no sample.
        """
        column = self._log.numbers(one.column)
        if column.is_absent:
            if key in NEEDED:
                raise RobotError(f"{self._log.path}: column {one.column!r} is empty; a signal needs numbers")
            return None
        is_there, n_before = _present(column)
        if n_before:
            self.losses.append(
                f"column {one.column!r} is no number before its value {n_before + 1}; {n_before} are left out"
            )
        found = []
        for name, (part, time_s) in zip(self.names, self._pieces_of(one, column), strict=True):
            kept = is_there[part]
            time_s = time_s if np.all(kept) else time_s[kept]  # signals with one clock share their times
            value = _to_si(column.value[part][kept], one, quantity, table)
            if not value.size:
                raise RobotError(f"{self._log.path}: column {one.column!r} has no value in motion {name!r}")
            if not np.all(np.isfinite(value)):
                row = int(np.flatnonzero(~np.isfinite(value))[0])
                message = None if column.message is None else column.message[part][kept][row]
                where = "" if message is None else f", message {message} of its topic"
                raise RobotError(
                    f"{self._log.path}: column {one.column!r}, motion {name!r}: is no finite number at "
                    f"{time_s[row]:.6g} s{where}; leave the cell empty or remove the row"
                )
            if np.abs(value).max() > MAX_VALUE:
                raise RobotError(
                    f"{self._log.path}: column {one.column!r}, motion {name!r}: reaches "
                    f"{np.abs(value).max():.3g} in SI units; leave the cells empty, or correct the unit"
                )
            if key == "position":
                self._check_rate(time_s, name)
            found.append(Signal(time_s, value))
        return found

    def _check_rate(self, time_s: Array, name: str) -> None:
        """Refuse times in another unit than the robot file says, and gaps that no simulation should cross."""
        if time_s.size < 2:
            raise RobotError(f"{self._log.path}: motion {name!r} has 1 position; a motion needs several")
        period_s = float(np.median(np.diff(time_s)))
        share = 1.0 / (period_s * self._file.control_rate_Hz)
        where = f"{self._log.path}: motion {name!r}"
        if not SLOWEST <= share <= FASTEST:
            raise RobotError(
                f"{where} has a position every {period_s:.3g} s, control_rate_Hz is "
                f"{self._file.control_rate_Hz:g}: {_other_unit(share, self._time_unit)}"
            )
        mean_s = float(time_s[-1] - time_s[0]) / (time_s.size - 1)
        if mean_s > MAX_PERIOD_S:
            said = (
                f"{where} has a position every {mean_s:.3g} s on average, at least one a second is needed; it"
            )
            raise self._long_gap(time_s, period_s, said)

    def _long_gap(self, time_s: Array, period_s: float, said: str) -> LongGap:
        """Return the error for a motion with gaps, with the windows that cut a log of one motion there."""
        pauses = find_pauses(time_s, period_s)
        longest_s = max((after - before for before, after in pauses), default=0.0)
        gaps = f"{pluralize(len(pauses), 'gap')} of up to {longest_s:.4g} s"
        gaps = f"has {1.0 / period_s:.4g} a second with {gaps}"
        if any(self._columns) or self._windows_s or not 0 < len(pauses) < MAX_WINDOWS:
            return LongGap(f"{said} {gaps}: end the motion there", {})
        ends_s = np.array([time_s[0], *np.ravel(pauses), time_s[-1]]) - self.start_s
        windows_s = cut_at_pauses(ends_s[0], ends_s[1:-1].reshape(-1, 2), ends_s[-1])
        return LongGap(f"{said} {gaps}: cut it there, in [motion] {windows_text(windows_s)}", windows_s)

    def labels(self, column: str) -> list[str]:
        """Return the text of a column by motion, empty for no column; RobotError if it changes within one."""
        if not column:
            return [""] * len(self.names)
        texts = self._log.texts(column)
        self._check_length(texts, column)
        named = zip(self.names, self._parts, strict=True)
        return [str(self._constant(texts[part], column, name)) for name, part in named]

    def values(self, column: str) -> list[float]:
        """Return the number of a column by motion; RobotError if it changes within one or is not finite."""
        values = self._log.numbers(column).value
        self._check_length(values, column)
        found = []
        for name, part in zip(self.names, self._parts, strict=True):
            if not np.isfinite(values[part]).all():
                raise RobotError(
                    f"{self._log.path}: column {column!r}, motion {name!r}: a row has no number; write one"
                )
            found.append(float(self._constant(values[part], column, name)))
        return found

    def gains(self, column: str) -> list[float]:
        """Return the gain by motion; RobotError if it changes within one, or is not positive."""
        found = self.values(column)
        for name, gain in zip(self.names, found, strict=True):
            if not 0.0 < gain < np.inf:
                raise RobotError(
                    f"{self._log.path}: column {column!r}, motion {name!r}: is {gain:g}; a gain is above 0"
                )
        return found

    def _constant(self, values: Any, column: str, name: str) -> Any:
        if np.any(values != values[0]):
            raise RobotError(
                f"{self._log.path}: column {column!r} changes within motion {name!r}; divide the motion there"
            )
        return values[0]

    def _pieces_of(self, one: SignalColumn, column: Column) -> Pieces:
        """Return rows and times of a signal in each motion; signals with one clock share the arrays."""
        path, name = self._log.path, one.time_column or self._time_column
        if not name and column.time_s is None:
            raise RobotError(f"{path}: has no times of its own; name its time column in time.column")
        if name:
            time_s = self._clock(name)
        else:
            assert column.time_s is not None
            time_s = column.time_s
        if time_s.size != column.value.size:
            raise RobotError(
                f"{path}: column {one.column!r} has {column.value.size} values, its times {time_s.size}; "
                "name a time_column as long as it"
            )
        if not name:
            return self._divide_times(time_s, one.column)
        if name not in self._pieces:
            self._pieces[name] = self._divide_times(time_s, name)
        return self._pieces[name]

    def _clock(self, name: str) -> Array:
        """Return the times of a time column [s]."""
        if name not in self._clocks:
            clock = self._log.numbers(name)
            if clock.is_present is not None or not np.all(np.isfinite(clock.value)):
                raise RobotError(
                    f"{self._log.path}: time column {name!r} has rows without a time; remove them"
                )
            self._clocks[name] = clock.value * UNITS[self._time_unit].factor
        return self._clocks[name]

    @property
    def start_s(self) -> float:
        """First time of all time columns, from which windows count; 0 for messages, which do so already."""
        signals = (one for table in self._file.joints.values() for one, _ in table.columns().values())
        names = {one.time_column or self._time_column for one in signals}
        return min((float(self._clock(name).min()) for name in names if name), default=0.0)

    def _divide_times(self, time_s: Array, name: str) -> Pieces:
        """Divide times by motion, and refuse those that do not increase."""
        self._check_length(time_s, name)
        parts = self._parts
        if self._windows_s:
            since_s = time_s - self.start_s
            parts = [
                np.flatnonzero((since_s >= low - ROUNDING_s) & (since_s <= high + ROUNDING_s))
                for low, high in self._windows_s
            ]
        for motion, part in zip(self.names, parts, strict=True):
            what = say_disorder(time_s[part], np.arange(1, time_s.size + 1)[part])
            if what:
                raise RobotError(f"{self._log.path}: motion {motion!r}: the time of {name!r} {what}")
        return [(part, time_s[part]) for part in parts]


def _present(column: Column) -> tuple[Flags, int]:
    """Return which cells have a value, (n,), and how many before the first number have none but NaN."""
    is_there = np.ones(column.value.size, np.bool_) if column.is_present is None else column.is_present.copy()
    before = np.arange(is_there.size) < int(np.argmax(is_there & ~np.isnan(column.value)))
    n_before = int(np.sum(is_there & before))
    is_there[before] = False
    return is_there, n_before


def _other_unit(share: float, unit: str) -> str:
    """Return which unit of time fits the rate of the controller, or by how much the times are wrong."""
    for ratio in (1e3, 1e6, 1e9, 1e-3, 1e-6, 1e-9):
        if SLOWEST <= share * ratio <= FASTEST:
            size = f"{ratio:.4g} times too long" if ratio > 1.0 else f"{1.0 / ratio:.4g} times too short"
            factor = UNITS[unit].factor / ratio
            others = [name for name in TIMES if math.isclose(UNITS[name].factor, factor)]
            advice = f"write time.unit = {others[0]!r}" if others else "convert them"
            return f"the times look {size}; {advice}"
    if share < 1.0:
        return f"the times look {SLOWEST / share:.2g} to {FASTEST / share:.2g} times too long; convert them"
    return f"the times look {share / FASTEST:.2g} to {share / SLOWEST:.2g} times too short; convert them"


def _as_slice(rows: Any) -> Any:
    """Return rows that follow one another as a slice, which copies nothing."""
    is_run = rows[-1] - rows[0] + 1 == rows.size
    return slice(int(rows[0]), int(rows[-1]) + 1) if is_run else rows


def _to_si(value: Array, one: SignalColumn, quantity: Quantity, table: JointTable) -> Array:
    """Convert logged values to SI units at the joint."""
    if quantity is Quantity.FLAG:
        return np.asarray(np.where(np.isnan(value), value, value != 0.0), dtype=np.float64)
    factor, offset = conversion(one, quantity, table)
    return value * factor + offset


def conversion(one: SignalColumn, quantity: Quantity, table: JointTable) -> tuple[float, float]:
    """Return factor and offset that convert logged values to SI units at the joint."""
    unit = find_unit(one.unit, quantity)
    factor, offset = unit.factor * one.factor, unit.offset
    if one.unit in COUNTS and one.counts_per_turn is not None:
        factor /= one.counts_per_turn
    if one.unit in SHARES and one.at_0_rad is not None and one.at_1_rad is not None:
        factor *= one.at_1_rad - one.at_0_rad
        offset = one.at_0_rad
    if one.side == "motor" and quantity in (Quantity.ANGLE, Quantity.SPEED):
        factor /= table.gear_ratio
    if one.side == "motor" and quantity is Quantity.TORQUE:
        factor *= table.gear_ratio
    return factor, offset + one.zero_rad


ANGLES: Final = ("position", "command", "secondary")
"""Signals that may be counters; the others are brought to the turn of the position."""
Signals = Mapping[str, Sequence[Signal]]
"""Name of a signal -> its samples in each motion."""
A_TURN: Final = 1.01
"""Largest range that has one turn: models write 3.1416 for half of it."""


@dataclass(frozen=True, slots=True)
class _Counter:
    turn_rad: float
    values: list[Array]
    """Of each motion, with turns added where the counter begins anew."""
    wraps: list[int]
    """How often it begins anew in each motion."""


def unwrap_counters(
    table: JointTable, signals: Signals, range_rad: tuple[float, float]
) -> tuple[Signals, list[int | None]]:
    """Add turns to the counters of one joint.

    A counter whose values span less than a turn in all motions knows no whole turns. A change by more than
    half a turn between two rows is one that began anew. The whole turn of each motion is that nearest

    - the command, if it knows its turn: a joint follows its command to less than half a turn;
    - else the middle of the range of the model, if that is at most a turn: no other turn lies in it;
    - else the first motion, so that all motions agree.

    Command and second encoder, if they are such counters, get the turn nearest the position. Where the range
    is more than a turn, this is done only if one of them did begin anew: else they may know their turns.

    Args:
        range_rad: Range of the joint in the model, infinite without limits.

    Returns:
        The signals, and for each motion how often counters began anew; None where nothing was changed.
    """
    found = dict(signals)
    counters = {key: one for key in ANGLES if (one := _counter(table, key, signals.get(key, ())))}
    is_sure = any(any(one.wraps) for one in counters.values())
    count: list[int | None] = [None] * len(signals["position"])
    for key, one in counters.items():
        middles = _middles(one.values)
        is_narrow = range_rad[1] - range_rad[0] <= A_TURN * one.turn_rad
        if not is_narrow and not is_sure:
            continue
        if key != "position":
            target = _middles([signal.value for signal in found["position"]])
        elif table.mode == "position" and "command" in found and "command" not in counters:
            target = _middles([signal.value for signal in found["command"]])
        else:
            target = np.full(middles.size, np.mean(range_rad) if is_narrow else middles[0])
        turns = np.round((target - middles) / one.turn_rad)
        found[key] = [
            Signal(signal.time_s, value + turn * one.turn_rad)
            for signal, value, turn in zip(signals[key], one.values, turns, strict=True)
        ]
        for k, wraps in enumerate(one.wraps):
            if wraps or turns[k]:
                count[k] = (count[k] or 0) + wraps
    return found, count


def _counter(table: JointTable, key: str, signals: Sequence[Signal]) -> _Counter | None:
    """Return a signal with turns added, if it is a counter of one turn."""
    column, quantity = table.columns().get(key, (None, None))
    if not signals or column is None or column.counts_per_turn is None or quantity is not Quantity.ANGLE:
        return None
    turn_rad = abs(conversion(column, quantity, table)[0]) * column.counts_per_turn
    if np.ptp(np.concatenate([one.value for one in signals])) >= turn_rad:
        return None
    values = [np.unwrap(one.value, period=turn_rad) for one in signals]
    steps = [np.abs(np.diff(after - one.value)) for after, one in zip(values, signals, strict=True)]
    return _Counter(turn_rad, values, [int(np.sum(step > turn_rad / 2.0)) for step in steps])


def _middles(values: Sequence[Array]) -> Array:
    """Return the middle of the range of each motion, (n_motions,) [rad]."""
    return np.array([(float(one.min()) + float(one.max())) / 2.0 for one in values])
