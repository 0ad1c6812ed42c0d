"""Records of an audit, and signals of a joint at the times of its positions."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.files.columns import SETTLING_S
from simgap.logs import JointLog, Motion, Signal
from simgap.result import Refusal
from simgap.simulation.windows import SLOPE_SAMPLES


class RemarkKind(StrEnum):
    """Kinds of remarks, the worst first."""

    UNIT = "unit looks wrong"
    WRAP = "lost turns"
    ORDER = "joints look exchanged"
    AHEAD = "position is ahead of its command"
    REPEATS = "repeats have other commands"
    CONSTANT = "signal is constant"
    SHORT = "motion is too short"
    STILL = "no excitation"
    SLOW = "rate is too low"
    SPIKE = "spikes"
    START = "standstill at the start"
    CONTACT = "contact with a plane"
    CUT_OFF = "command is cut off"
    SATURATION = "saturation"
    COLLISION = "collision in the model"
    TURNS = "many turns"
    COUNTER = "counter wraps"
    STALE = "stale samples"
    PAUSE = "pauses"
    MISSING = "missing samples"
    JITTER = "uneven rate"


REFUSED: Final = frozenset(
    {
        *(RemarkKind.UNIT, RemarkKind.WRAP, RemarkKind.ORDER),
        *(RemarkKind.REPEATS, RemarkKind.CONSTANT, RemarkKind.SHORT),
    }
)
"""Remarks on logs that say something else than happened: a diagnosis refuses them."""


@dataclass(frozen=True, slots=True)
class Remark:
    """Something that the logs show and that is not an effect of the catalogue."""

    kind: RemarkKind
    joint: str
    """Name of the joint; empty for the whole robot."""
    motions: tuple[str, ...]
    text: str
    """Sentence for the user."""
    value: float = float("nan")
    """Number that was estimated, in `unit`; NaN if there is none."""
    interval: tuple[float, float] = (float("nan"), float("nan"))
    """90 % interval of the value."""
    unit: str = ""


@dataclass(frozen=True, slots=True)
class SignalRate:
    """Rate of the position of one joint in one motion."""

    motion: str
    joint: str
    n_samples: int
    duration_s: float
    rate_Hz: float
    """Reciprocal of the median period; NaN for fewer than two samples."""
    jitter_s: float
    """Half the distance of the quantiles 5 % and 95 % of the period."""
    n_missing: int
    """Positions that are missing in gaps and at the ends of a motion, without pauses of the log."""
    n_held: int
    """Positions without a command where most have one: the last one is held."""
    longest_s: float
    """Longest time between two positions that is no pause of the log; NaN for fewer than two."""
    n_invalid: int
    """Samples that are not finite."""
    n_stale: int
    """Samples that repeat an old value while the joint moves."""


@dataclass(frozen=True, slots=True)
class Audit:
    """Result of an audit."""

    rates: tuple[SignalRate, ...]
    remarks: tuple[Remark, ...]
    """The worst first."""
    refused: tuple[Refusal, ...]
    usable: Mapping[tuple[str, str], Flags]
    """(motion, joint) -> flags over its position samples."""
    untested: tuple[str, ...] = ()
    """What these logs cannot show, each with the reason."""

    def is_usable(self, motion: str, joint: str) -> Flags:
        """Return which position samples of a joint a diagnosis may use, (n,)."""
        return self.usable[motion, joint]


@dataclass(frozen=True, slots=True)
class Samples:
    """Position and command of one joint in one motion at the finite position samples."""

    index: Integers
    """Indices of these samples among all position samples."""
    time_s: Array
    position: Array
    command: Array
    """NaN without a command, and while the motor is off."""


Faulty = Mapping[tuple[str, str], Mapping[str, Flags]]
"""By motion and joint, and by what is wrong, flags over all position samples."""


def joint_samples(log: JointLog) -> Samples:
    """Return the finite samples of a joint, with the command that was valid at each."""
    position = log.position
    index = np.flatnonzero(np.isfinite(position.value) & np.isfinite(position.time_s))
    time_s = position.time_s[index]
    command = np.full(index.size, np.nan) if log.command is None else hold(log.command, time_s)
    if log.enabled is not None:
        command = np.where(hold(log.enabled, time_s) > 0.5, command, np.nan)
    return Samples(index, time_s, position.value[index], command)


def samples_of(motions: Sequence[Motion], joint: str) -> dict[str, Samples]:
    """Return the finite samples of a joint by motion, of motions that have any."""
    found = {one.name: joint_samples(one.joints[joint]) for one in motions if joint in one.joints}
    return {name: one for name, one in found.items() if one.position.size}


def is_short(log: JointLog) -> bool:
    """Tell whether a motion has too few positions for a velocity, or ends before a joint settles."""
    time_s = joint_samples(log).time_s
    return time_s.size < SLOPE_SAMPLES or bool(time_s[-1] - time_s[0] < SETTLING_S)


def span(values: Array) -> float:
    """Return the range of the finite values; 0 without any."""
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if known.size else 0.0


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


def say_times(count: int) -> str:
    """Return a count as in "it happens 3 times"."""
    return "once" if count == 1 else f"{count} times"


def robust_sigma(values: Array) -> float:
    """Return the standard deviation that the median absolute deviation of normal values (n,) stands for."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else 0.0


STEPS: Final = 4.0
"""A joint moves clearly if it goes by this many steps of its encoder in one period."""
COARSE_RAD: Final = STEPS * math.tau / 2**10
"""A joint follows a command that spans this: the coarsest encoders of servos have ten bits."""


def encoder_step_rad(motions: Sequence[Motion], joint: str) -> float:
    """Return the smallest change of a position, at least what single precision shows of it; 0 without any."""
    values = [one.position for one in samples_of(motions, joint).values()]
    largest = max((float(np.abs(one).max()) for one in values), default=0.0)
    steps = np.concatenate([np.zeros(0), *(np.abs(np.diff(one)) for one in values)])
    steps = steps[steps > 4.0 * np.finfo(np.float32).eps * largest]
    return float(steps.min()) if steps.size else 0.0
