"""Counters of one turn: turns are added where they begin anew, and each motion gets its whole turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.files.motion_rows import conversion
from simgap.files.robot_file import JointTable
from simgap.logs import Signal
from simgap.units import Quantity

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
