"""Signals of a joint at the times of its positions."""

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.logs import JointLog, Signal


@dataclass(frozen=True, slots=True)
class Samples:
    """Position and command of one joint in one motion at the finite position samples."""

    index: Integers
    """Indices of these samples among all position samples."""
    time_s: Array
    position: Array
    command: Array
    """NaN without a command, and while the motor is off."""


def joint_samples(log: JointLog) -> Samples:
    """Return the finite samples of a joint, with the command that was valid at each."""
    position = log.position
    index = np.flatnonzero(np.isfinite(position.value) & np.isfinite(position.time_s))
    time_s = position.time_s[index]
    command = np.full(index.size, np.nan) if log.command is None else hold(log.command, time_s)
    if log.enabled is not None:
        command = np.where(hold(log.enabled, time_s) > 0.5, command, np.nan)
    return Samples(index, time_s, position.value[index], command)


def hold(signal: Signal, time_s: Array) -> Array:
    """Return the last value at or before each time, (n,); the first value before the first sample."""
    if signal.time_s.size == 0:
        return np.full(time_s.shape, np.nan)
    at = np.searchsorted(signal.time_s, time_s, side="right") - 1
    return signal.value[np.maximum(at, 0)]


def runs(flags: Flags) -> list[tuple[int, int]]:
    """Return begin and end (exclusive) of each run of true flags, (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def robust_sigma(values: Array) -> float:
    """Return the standard deviation that the median absolute deviation of normal values (n,) stands for."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else 0.0
