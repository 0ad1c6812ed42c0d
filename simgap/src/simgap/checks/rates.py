"""Rates of the logs: missing rows, pauses and an uneven period."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags
from simgap.checks.records import (
    Faulty,
    Remark,
    RemarkKind,
    SignalRate,
    hold,
    is_short,
    joint_samples,
    say_times,
)
from simgap.common.console import pluralize
from simgap.files.columns import GAP, MAX_WINDOWS, SETTLING_S, cut_at_pauses, find_pauses, windows_text
from simgap.logs import JointLog, Motion
from simgap.robot import Robot

JITTER_SHARE: Final = 0.25
"""Jitter of this share of the period is worth a remark: linear interpolation is then wrong by as much."""
REMARK_SHARE: Final = 0.01
"""Share of missing or stale rows that is worth a remark."""
Pauses = Mapping[str, Sequence[tuple[float, float]]]
"""Motion -> last time before and first time after each of its pauses [s]."""


def audit_rates(
    robot: Robot, motions: Sequence[Motion], faulty: Faulty
) -> tuple[tuple[SignalRate, ...], list[Remark]]:
    """Return the rates of all joints in all motions, and remarks about them."""
    clocks_s = {motion.name: _clocks_s(motion) for motion in motions}
    pauses = {motion.name: _find_pauses(motion, clocks_s[motion.name]) for motion in motions}
    every = [(motion.name, joint, log) for motion in motions for joint, log in motion.joints.items()]
    # a command that is sent by row in one motion is sent so in all
    by_row = {joint for _, joint, log in every if (has := _has_command(log)).sum() > 0.5 * has.size}
    rates = []
    for motion, joint, log in every:
        gaps_s = _find_gaps(joint_samples(log).time_s, clocks_s[motion], pauses[motion])
        n_held = int(np.sum(_is_on(log) & ~_has_command(log))) if joint in by_row else 0
        rates.append(_rate(motion, joint, log, gaps_s, n_held, int(faulty[motion, joint]["stale"].sum())))
    own = (*_describe_pauses(robot, motions, pauses), *_describe_short(motions, rates))
    return tuple(rates), [*own, *_remarks(rates)]


def _clocks_s(motion: Motion) -> list[Array]:
    """Return the times of the signals of a motion, those that many share once."""
    signals = [getattr(log, one.name) for log in motion.joints.values() for one in fields(log)]
    clocks = {id(one.time_s): one.time_s for one in signals if one is not None}
    return [one[np.isfinite(one)] for one in clocks.values()]


def _find_pauses(motion: Motion, clocks_s: Sequence[Array]) -> list[tuple[float, float]]:
    """Find times in which no signal has a sample: there, no rows are missing, but the log rests."""
    logs = motion.joints.values()
    periods_s = [np.median(np.diff(log.position.time_s)) for log in logs if log.position.time_s.size > 1]
    return find_pauses(np.unique(np.concatenate(clocks_s)), max(periods_s, default=0.0))


def _describe_pauses(robot: Robot, motions: Sequence[Motion], pauses: Pauses) -> Iterator[Remark]:
    """Remark pauses, with the windows that cut a log of one motion there."""
    names = tuple(name for name, found in pauses.items() if found)
    if not names:
        return
    every = [end_s - begin_s for found in pauses.values() for begin_s, end_s in found]
    table = None if robot.file is None else robot.file.motion
    advice = "end the motion there"
    if table and len(motions) == 1 and not (table.columns or table.windows_s) and len(every) < MAX_WINDOWS:
        windows = windows_text(pause_windows_s(motions[0]))
        advice = f"cut it into motions there, in [motion] {windows}"
    most = f"{max(every):.3g} s{' at most' * (len(every) > 1)}"
    text = f"no signal is logged for {most}, {say_times(len(every))}: {advice}"
    yield Remark(RemarkKind.PAUSE, "", names, text, max(every), unit="s")


def pause_windows_s(motion: Motion) -> dict[str, list[float]]:
    """Return the windows that cut the log of a motion at its pauses, by name [s]; none if it has no pause."""
    start_s = motion.start_s
    pauses = [(low + start_s, high + start_s) for low, high in _find_pauses(motion, _clocks_s(motion))]
    end_s = max(float(log.position.time_s[-1]) for log in motion.joints.values())
    return cut_at_pauses(start_s, pauses, start_s + end_s) if pauses else {}


def _describe_short(motions: Sequence[Motion], rates: Sequence[SignalRate]) -> Iterator[Remark]:
    """Remark motions in which nothing can show."""
    short = {(one.name, name) for one in motions for name, log in one.joints.items() if is_short(log)}
    own = [rate for rate in rates if (rate.motion, rate.joint) in short]
    if own:
        least = min(own, key=lambda rate: (rate.duration_s, rate.n_samples))
        text = (
            f"it has {pluralize(least.n_samples, 'row')} in {least.duration_s:.3g} s, and a joint needs "
            f"{SETTLING_S:g} s to settle: leave it out, or record for some seconds"
        )
        names = tuple(dict.fromkeys(rate.motion for rate in own))
        yield Remark(RemarkKind.SHORT, "", names, text, least.duration_s, unit="s")


def _find_gaps(time_s: Array, clocks_s: Sequence[Array], pauses: Sequence[tuple[float, float]]) -> Array:
    """Return times between positions that are longer than their period, (n,), without the pauses in them.

    Args:
        time_s: Times of the positions of a joint.
        clocks_s: Times of signals. Of those that share most times of the positions, none is expected before
            the first and after the last.
        pauses: Last time before and first time after each pause of the log.
    """
    if time_s.size < 2:
        return np.zeros(0)
    median_s = float(np.median(np.diff(time_s)))
    shared = [time_s, *(one for one in clocks_s if np.isin(time_s, one).mean() > 0.5)]
    begin_s, end_s = min(one[0] for one in shared) - median_s, max(one[-1] for one in shared) + median_s
    time_s = np.array([begin_s, *time_s, end_s])
    period_s = np.diff(time_s)
    for begin_s, end_s in pauses:
        period_s[(time_s[:-1] <= begin_s) & (time_s[1:] >= end_s)] -= end_s - begin_s
    return period_s[period_s > GAP * median_s]


def _has_command(log: JointLog) -> Flags:
    """Return which positions of a joint have a command of the same time, (n,)."""
    time_s = joint_samples(log).time_s
    return np.isin(time_s, () if log.command is None else log.command.time_s)


def _is_on(log: JointLog) -> Flags:
    """Return at which positions of a joint its motor is on, (n,)."""
    time_s = joint_samples(log).time_s
    return np.ones(time_s.size, np.bool_) if log.enabled is None else hold(log.enabled, time_s) > 0.5


def _rate(motion: str, joint: str, log: JointLog, gaps_s: Array, n_held: int, n_stale: int) -> SignalRate:
    samples, n = joint_samples(log), log.position.value.size
    period = np.diff(samples.time_s)
    n_invalid = n - samples.index.size
    if log.command is not None:
        n_invalid += int(np.sum(~np.isfinite(log.command.value)))
    if period.size == 0:
        nan = math.nan
        return SignalRate(motion, joint, n, 0.0, nan, nan, 0, 0, nan, n_invalid, n_stale)
    median = float(np.median(period))
    low, high = np.quantile(period, [0.05, 0.95])
    return SignalRate(
        motion=motion,
        joint=joint,
        n_samples=n,
        duration_s=float(samples.time_s[-1] - samples.time_s[0]),
        rate_Hz=1.0 / median if median > 0.0 else math.nan,
        jitter_s=float(high - low) / 2.0,
        n_missing=int(np.sum(np.round(gaps_s / median) - 1.0)) if median > 0.0 else 0,
        n_held=n_held,
        longest_s=float(np.max([*gaps_s, *period[period <= GAP * median]])),
        n_invalid=n_invalid,
        n_stale=n_stale,
    )


def _remarks(rates: Sequence[SignalRate]) -> Iterator[Remark]:
    for joint in dict.fromkeys(rate.joint for rate in rates):
        own = [rate for rate in rates if rate.joint == joint]
        n_samples = sum(rate.n_samples for rate in own)
        stale = [rate for rate in own if rate.n_stale > REMARK_SHARE * rate.n_samples]
        if stale:
            count = sum(rate.n_stale for rate in stale)
            text = f"{count} positions repeat an old value while the joint moves"
            yield Remark(RemarkKind.STALE, joint, _names(stale), text, count / n_samples)
        gaps = [rate for rate in own if _has_gaps(rate) or rate.n_invalid]
        if gaps:
            missing, held = sum(r.n_missing for r in gaps), sum(r.n_held for r in gaps)
            invalid, longest_s = sum(r.n_invalid for r in gaps), max(r.longest_s for r in gaps)
            parts = [f"{missing} rows are missing, {longest_s:.3g} s at once at most"] * bool(missing)
            parts += [f"{held} rows have no command: the last one counts there"] * bool(held)
            parts += [f"{invalid} values are no numbers"] * bool(invalid)
            text, count = " and ".join(parts), missing + held + invalid
            yield Remark(RemarkKind.MISSING, joint, _names(gaps), text, count / (n_samples + missing))
        uneven = [rate for rate in own if rate.jitter_s * rate.rate_Hz > JITTER_SHARE]
        if uneven:
            worst = max(uneven, key=lambda rate: rate.jitter_s)
            text = f"the period varies by +-{worst.jitter_s * 1e3:.1f} ms at {worst.rate_Hz:.0f} Hz"
            yield Remark(RemarkKind.JITTER, joint, _names(uneven), text, worst.jitter_s, unit="s")


def _has_gaps(rate: SignalRate) -> bool:
    most = REMARK_SHARE * rate.n_samples
    is_long = rate.n_missing > 0 and rate.longest_s > SETTLING_S
    return is_long or rate.n_missing + rate.n_held > most


def _names(rates: Sequence[SignalRate]) -> tuple[str, ...]:
    return tuple(rate.motion for rate in rates)
