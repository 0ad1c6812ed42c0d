"""Records of an audit, signals of a joint at the times of its positions, and rates of the logs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.logs import JointLog, Motion, Signal
from simgap.result import Refusal
from simgap.robot import ControlMode, Robot


class RemarkKind(StrEnum):
    """Kinds of remarks, the worst first."""

    UNIT = "unit looks wrong"
    WRAP = "lost turns"
    ORDER = "joints look exchanged"
    CONSTANT = "position is constant"
    STILL = "no excitation"
    SPIKE = "spikes"
    START = "standstill at the start"
    CONTACT = "contact with a plane"
    CUT_OFF = "command is cut off"
    SATURATION = "saturation"
    COLLISION = "collision in the model"
    TURNS = "many turns"
    COUNTER = "counter wraps"
    STALE = "stale samples"
    MISSING = "missing samples"
    JITTER = "uneven rate"


REFUSED: Final = frozenset({RemarkKind.UNIT, RemarkKind.WRAP, RemarkKind.ORDER, RemarkKind.CONSTANT})
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
    """Rows that are missing in gaps between samples."""
    longest_s: float
    """Longest time between two samples; NaN for fewer than two."""
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


GAP: Final = 2.5
"""A row is missing where a period exceeds this many medians: two rows and half a period of jitter."""
GAP_S: Final = 0.3
"""A gap of this length, or a step of the clock, is worth a remark: a joint settles in it unseen."""
JITTER_SHARE: Final = 0.25
"""Jitter of this share of the period is worth a remark: linear interpolation is then wrong by as much."""
REMARK_SHARE: Final = 0.01
"""Share of missing or stale rows that is worth a remark."""
STEPS: Final = 4.0
"""A joint moves clearly if it goes by this many steps of its encoder in one period."""
COARSE_RAD: Final = STEPS * 2.0 * math.pi / 2**10
"""A joint follows a command that spans this: the coarsest encoders of servos have ten bits."""
REPEATS: Final = 3
"""Same values in a row that count as stale; fewer are usual where a bus is read faster than its servo."""


def audit_rates(motions: Sequence[Motion]) -> tuple[tuple[SignalRate, ...], list[Remark]]:
    """Return the rates of all joints in all motions, and remarks about them."""
    resolution = {name: encoder_step_rad(motions, name) for name in _joint_names(motions)}
    rates = tuple(
        _rate(motion.name, name, log, resolution[name])
        for motion in motions
        for name, log in motion.joints.items()
    )
    return rates, list(_remarks(rates))


def find_constant_positions(robot: Robot, motions: Sequence[Motion]) -> list[Remark]:
    """Find joints whose position never changes although their commands do."""
    found: list[Remark] = []
    for joint in robot.joints:
        logs = {m.name: joint_samples(m.joints[joint.name]) for m in motions if joint.name in m.joints}
        positions = np.concatenate([np.zeros(0), *(one.position for one in logs.values())])
        if joint.mode is not ControlMode.POSITION or not positions.size or np.ptp(positions) > 0.0:
            continue
        commands = {name: one.command[np.isfinite(one.command)] for name, one in logs.items()}
        spans = {name: float(np.ptp(one)) for name, one in commands.items() if one.size}
        moved = tuple(name for name, span in spans.items() if span > COARSE_RAD * joint.per_rad)
        if moved:
            text = (
                f"the position stays at {joint.show(positions[0])}, while the command spans "
                f"{joint.show(max(spans.values()), '.3g')}: is the encoder dead, or is it the wrong column?"
            )
            found.append(
                Remark(RemarkKind.CONSTANT, joint.name, moved, text, float(positions[0]), unit=joint.unit)
            )
    return found


def stale_flags(samples: Samples, step_rad: float) -> Flags:
    """Flag values that repeat while the joint moves on, (n,).

    A value is stale if it is repeated several times, the joint moved clearly before, and jumps afterwards by
    about what it missed. A joint that friction holds does not jump.
    """
    position, flags = samples.position, np.zeros(samples.position.size, np.bool_)
    if position.size < REPEATS + 2:
        return flags
    step = np.diff(position)
    for begin, end in runs(step == 0.0):
        if end - begin < REPEATS or begin == 0 or end >= step.size:
            continue
        before, jump = step[begin - 1], step[end]
        is_moving = abs(before) > STEPS * step_rad
        missed = abs(before) * (end - begin)
        if is_moving and abs(jump) > max(0.5 * missed, 2.0 * abs(before)):
            flags[begin + 1 : end + 1] = True
    return flags


def _joint_names(motions: Sequence[Motion]) -> list[str]:
    return list(dict.fromkeys(name for motion in motions for name in motion.joints))


def encoder_step_rad(motions: Sequence[Motion], joint: str) -> float:
    """Return the smallest change of a position, at least what single precision shows of it."""
    smallest, largest = math.inf, 0.0
    for motion in motions:
        if joint in motion.joints:
            value = motion.joints[joint].position.value
            value = value[np.isfinite(value)]
            largest = max(largest, float(np.abs(value).max(initial=0.0)))
            change = np.abs(np.diff(value))
            change = change[change > 4.0 * np.finfo(np.float32).eps * largest]
            smallest = min(smallest, float(change.min(initial=math.inf)))
    return smallest if math.isfinite(smallest) else 0.0


def _rate(motion: str, joint: str, log: JointLog, step_rad: float) -> SignalRate:
    samples, n = joint_samples(log), log.position.value.size
    period = np.diff(samples.time_s)
    n_invalid = n - samples.index.size + _invalid_commands(log)
    if period.size == 0:
        nan = math.nan
        return SignalRate(motion, joint, n, 0.0, nan, nan, 0, nan, n_invalid, 0)
    median = float(np.median(period))
    low, high = np.quantile(period, [0.05, 0.95])
    gaps = period[period > GAP * median]
    return SignalRate(
        motion=motion,
        joint=joint,
        n_samples=n,
        duration_s=float(samples.time_s[-1] - samples.time_s[0]),
        rate_Hz=1.0 / median if median > 0.0 else math.nan,
        jitter_s=float(high - low) / 2.0,
        n_missing=int(np.sum(np.round(gaps / median) - 1.0)) if median > 0.0 else 0,
        longest_s=float(period.max()),
        n_invalid=n_invalid,
        n_stale=int(np.sum(stale_flags(samples, step_rad))),
    )


def _invalid_commands(log: JointLog) -> int:
    command: Array = np.zeros(0) if log.command is None else log.command.value
    return int(np.sum(~np.isfinite(command)))


def _remarks(rates: Sequence[SignalRate]) -> list[Remark]:
    found: list[Remark] = []
    for joint in dict.fromkeys(rate.joint for rate in rates):
        own = [rate for rate in rates if rate.joint == joint]
        n_samples = sum(rate.n_samples for rate in own)
        stale = [rate for rate in own if rate.n_stale > REMARK_SHARE * rate.n_samples]
        if stale:
            count = sum(rate.n_stale for rate in stale)
            text = f"{count} positions repeat an old value while the joint moves"
            found.append(Remark(RemarkKind.STALE, joint, _names(stale), text, count / n_samples))
        gaps = [rate for rate in own if _has_gaps(rate) or rate.n_invalid]
        if gaps:
            missing, invalid = sum(r.n_missing for r in gaps), sum(r.n_invalid for r in gaps)
            longest_s = max(r.longest_s for r in gaps)
            parts = [f"{missing} rows are missing, {longest_s:.3g} s at once at most"] * bool(missing)
            parts += [f"{invalid} values are no numbers"] * bool(invalid)
            found.append(
                Remark(
                    RemarkKind.MISSING,
                    joint,
                    _names(gaps),
                    " and ".join(parts),
                    (missing + invalid) / n_samples,
                )
            )
        uneven = [rate for rate in own if rate.jitter_s * rate.rate_Hz > JITTER_SHARE]
        if uneven:
            worst = max(uneven, key=lambda rate: rate.jitter_s)
            text = f"the period varies by +-{worst.jitter_s * 1e3:.1f} ms at {worst.rate_Hz:.0f} Hz"
            found.append(Remark(RemarkKind.JITTER, joint, _names(uneven), text, worst.jitter_s, unit="s"))
    return found


def _has_gaps(rate: SignalRate) -> bool:
    return rate.n_missing > 0 and (rate.n_missing > REMARK_SHARE * rate.n_samples or rate.longest_s > GAP_S)


def _names(rates: Sequence[SignalRate]) -> tuple[str, ...]:
    return tuple(rate.motion for rate in rates)
