"""Faults of single signals: turns that are lost, samples that jump away, joints that stand still."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, percentile_filter

from simgap.arrays import Array, Flags
from simgap.checks import records
from simgap.logs import Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint

WINDOW: Final = 21
"""Steps around one that say what is usual there: a spike makes two of them, and five may be larger."""
SURE: Final = 5.0
"""Ratio to what is usual near by: steps of a sine wave have 1.3 at most, of normal noise 3.5 in a million."""
SIGMAS: Final = 8.0
"""Standard deviations of noise that a spike exceeds: normal noise does so once in 1e15 samples."""


def _usual_steps(value: Array) -> Array:
    """Return the upper quartile of the sizes of the steps around each step, (n - 1,)."""
    return np.asarray(percentile_filter(np.abs(np.diff(value)), 75, WINDOW, mode="nearest"))


ROUND: Final = 0.1
"""Share of a turn, or of a range, by which whole turns may be missed: a joint moves by less in a row."""


def find_wraps(robot: Robot, motions: Sequence[Motion]) -> Iterator[records.Remark]:
    """Find positions and commands that jump by whole turns between two rows, and counters that did."""
    for joint in robot.joints:
        wraps = {one.name: one.unwrapped[joint.name] for one in motions if joint.name in one.unwrapped}
        if wraps:
            count = sum(wraps.values())
            text = (
                f"the counter wraps {records.say_times(count)}; it is unwrapped"
                if count
                else "the counter knows no whole turns; it is moved by turns to where the joint is"
            )
            yield records.Remark(records.RemarkKind.COUNTER, joint.name, tuple(wraps), text, float(count))
        for name in ("position", "command", "secondary") if not joint.is_slide else ():
            if name == "command" and joint.mode is not ControlMode.POSITION:
                continue
            jumps = {one.name: n for one in motions if (n := _count_turns(one, joint.name, name))}
            if jumps:
                count = sum(jumps.values())
                often = records.say_times(count)
                text = (
                    f"the {name} jumps by whole turns (6.28 rad) between two rows, {often}: it wraps. "
                    "Unwrap it, or give the unit count with the counts_per_turn where it begins anew"
                )
                yield records.Remark(records.RemarkKind.WRAP, joint.name, tuple(jumps), text, float(count))


def _count_turns(motion: Motion, joint: str, name: str) -> int:
    signal: Signal | None = getattr(motion.joints[joint], name) if joint in motion.joints else None
    if signal is None:
        return 0
    value = signal.value[np.isfinite(signal.value)]
    if value.size < 2:
        return 0
    step, usual = np.abs(np.diff(value)), SURE * _usual_steps(value)
    whole = np.round(step / math.tau)
    rest = np.abs(step - whole * math.tau)
    is_turn = (whole >= 1.0) & (step > usual) & (rest <= np.minimum(usual, ROUND * math.tau) + 1e-9)
    return int(np.sum(is_turn))


def spike_flags(samples: records.Samples, step_rad: float) -> Flags:
    """Flag one or two samples that jump away from those before and after, (n,).

    Their distance from the mean of these neighbours is compared with the steps that are usual near by, with
    noise and the step of the encoder, and with the range of the command near by. So neither fast motion nor
    oscillation counts, nor the answer to a pulse.
    """
    value, flags = samples.position, np.zeros(samples.position.size, np.bool_)
    if value.size < WINDOW:
        return flags
    sent = np.nan_to_num(samples.command)
    commanded = maximum_filter1d(sent, WINDOW) - minimum_filter1d(sent, WINDOW)
    least = SURE * _usual_steps(value) + SIGMAS * _noise_rad(value) + records.STEPS * step_rad
    least = np.maximum(least, commanded[:-1])
    for width in (1, 2):
        before, after = value[: -width - 1], value[width + 1 :]
        inside = np.stack([value[1 + k : value.size - width + k] for k in range(width)])
        away = np.abs(inside - (before + after) / 2.0).min(axis=0)
        is_away = away > np.maximum(least[: away.size], np.abs(after - before))
        for k in range(width):
            flags[1 + k : value.size - width + k] |= is_away
    return flags


REPEATS: Final = 3
"""Same values in a row that count as stale; fewer are usual where a bus is read faster than its servo."""


def stale_flags(samples: records.Samples, step_rad: float) -> Flags:
    """Flag values that repeat while the joint moves on, (n,).

    A value is stale if it is repeated several times, the joint moved clearly before, and jumps afterwards by
    about what it missed. A joint that friction holds does not jump.
    """
    position, flags = samples.position, np.zeros(samples.position.size, np.bool_)
    if position.size < REPEATS + 2:
        return flags
    step = np.diff(position)
    for begin, end in records.runs(step == 0.0):
        if end - begin < REPEATS or begin == 0 or end >= step.size:
            continue
        before, jump = step[begin - 1], step[end]
        is_moving = abs(before) > records.STEPS * step_rad
        missed = abs(before) * (end - begin)
        if is_moving and abs(jump) > max(0.5 * missed, 2.0 * abs(before)):
            flags[begin + 1 : end + 1] = True
    return flags


def flag_samples(motions: Sequence[Motion]) -> records.Faulty:
    """Flag position samples that are no number, stale, or spikes."""
    names = dict.fromkeys(name for motion in motions for name in motion.joints)
    step_rad = {name: records.encoder_step_rad(motions, name) for name in names}
    found: dict[tuple[str, str], dict[str, Flags]] = {}
    for motion in motions:
        for name, log in motion.joints.items():
            samples, n = records.joint_samples(log), log.position.value.size
            flags = {"not finite": np.ones(n, np.bool_)}
            flags["not finite"][samples.index] = False
            for fault, find in (("stale", stale_flags), ("spike", spike_flags)):
                flags[fault] = np.zeros(n, np.bool_)
                flags[fault][samples.index] = find(samples, step_rad[name])
            found[motion.name, name] = flags
    return found


def describe_spikes(
    robot: Robot, motions: Sequence[Motion], faulty: records.Faulty
) -> Iterator[records.Remark]:
    """Remark positions that jump away for a sample or two."""
    for joint in robot.joints:
        own = records.samples_of(motions, joint.name)
        spikes = {name: faulty[name, joint.name]["spike"][one.index] for name, one in own.items()}
        away_rad = {
            name: np.abs(one.position - np.median(one.position))[spikes[name]]
            for name, one in own.items()
            if np.any(spikes[name])
        }
        if away_rad:
            every = np.concatenate(list(away_rad.values()))
            text = (
                f"{every.size} positions jump away for a sample or two, to {joint.show(every.max(), '.3g')} "
                "from the median: were they read wrongly?"
            )
            names, furthest = tuple(away_rad), float(every.max())
            yield records.Remark(records.RemarkKind.SPIKE, joint.name, names, text, furthest, unit=joint.unit)


SPREAD: Final = 10.0
"""Range of a position in standard deviations of its noise from which the joint moves: noise alone has 4.7."""


def find_still_joints(robot: Robot, motions: Sequence[Motion]) -> Iterator[records.Remark]:
    """Find joints that hardly move in any motion, and positions that never change while commands do."""
    for joint in robot.joints:
        own = records.samples_of(motions, joint.name)
        positions = [one.position for one in own.values()]
        step_rad = records.encoder_step_rad(motions, joint.name)
        if any(_is_coarse(one, joint) for one in own.values()):
            continue
        noise_rad = max([_noise_rad(one) for one in positions] + [step_rad / 12**0.5])
        ranges_rad = [float(np.ptp(np.quantile(one, [0.01, 0.99]))) for one in positions]  # without outliers
        spread_rad = max(ranges_rad, default=math.inf)
        if spread_rad > SPREAD * noise_rad:
            continue
        place, is_constant = joint.show(positions[0][0]), records.span(np.concatenate(positions)) == 0.0
        sent = {name: records.span(one.command) for name, one in own.items()}
        moved = tuple(name for name, one in sent.items() if one > records.COARSE_RAD * joint.per_rad)
        if is_constant and moved and joint.mode is ControlMode.POSITION:
            text = (
                f"the position stays at {place}, while the command spans "
                f"{joint.show(max(sent.values()), '.3g')}: is the encoder dead, or is it the wrong column?"
            )
            value = float(positions[0][0])
            yield records.Remark(records.RemarkKind.CONSTANT, joint.name, moved, text, value, unit=joint.unit)
            continue
        text = (
            f"the joint never moves: its position stays at {place}"
            if is_constant
            else f"the joint hardly moves: its positions range over {joint.show_small(spread_rad)}, "
            f"their noise is {joint.show_small(noise_rad, '.2g')}"
        )
        text += ". Nothing about this joint can be identified"
        yield records.Remark(
            records.RemarkKind.STILL, joint.name, tuple(own), text, spread_rad, unit=joint.unit
        )


def find_idle_signals(robot: Robot, motions: Sequence[Motion]) -> Iterator[records.Remark]:
    """Find velocities and torques that never change while position and command do: they are not measured."""
    for joint in robot.joints:
        least_rad = records.COARSE_RAD * joint.per_rad
        moves = {
            name
            for name, one in records.samples_of(motions, joint.name).items()
            if min(records.span(one.position), records.span(one.command)) > least_rad
        }
        names = tuple(one.name for one in motions if one.name in moves)
        logs = [one.joints[joint.name] for one in motions if one.name in moves]
        for key, what, kind in (
            ("velocity", "velocity", records.RemarkKind.MISSING),
            ("torque", "torque (or current)", records.RemarkKind.CONSTANT),
        ):
            signals = [signal for log in logs if (signal := getattr(log, key)) is not None]
            values = np.concatenate([np.zeros(0), *(one.value for one in signals)])
            if values.size and np.ptp(values) == 0.0 and joint.mode is ControlMode.POSITION:
                text = (
                    f"the {what} stays at {values[0]:.3g} while the joint moves: it was not measured; "
                    "take it out of the robot file, or name another column"
                )
                yield records.Remark(kind, joint.name, names, text, float(values[0]))


def find_dead_commands(robot: Robot, motions: Sequence[Motion]) -> Iterator[records.Remark]:
    """Find joints under power that still move late in a motion, while their commands never change."""
    for joint in (one for one in robot.joints if one.mode is ControlMode.POSITION):
        logs = [one.joints[joint.name] for one in motions if joint.name in one.joints]
        own = records.samples_of(motions, joint.name)
        late_rad = [records.span(one.position[one.position.size // 2 :]) for one in own.values()]
        is_dead = all(log.command is not None and np.ptp(log.command.value) == 0.0 for log in logs)
        is_on = all(log.enabled is None or np.all(log.enabled.value >= 0.5) for log in logs)
        if is_dead and is_on and max(late_rad, default=0.0) > records.COARSE_RAD * joint.per_rad:
            text = (
                f"the command never changes, while the position spans {joint.show(max(late_rad), '.3g')}: "
                "is it the wrong column, or was the power off? Name the right one, or the signal enabled"
            )
            yield records.Remark(records.RemarkKind.CONSTANT, joint.name, tuple(own), text, max(late_rad))


def find_low_rates(robot: Robot, motions: Sequence[Motion]) -> Iterator[records.Remark]:
    """Find joints that move so fast that a log has few samples of each wave."""
    for joint in robot.joints:
        own = records.samples_of(motions, joint.name)
        coarse = {name: one for name, one in own.items() if _is_coarse(one, joint)}
        if coarse:
            rate_Hz = min(1.0 / float(np.median(np.diff(one.time_s))) for one in coarse.values())
            text = (
                f"{rate_Hz:.3g} rows a second are fewer than nine in a wave of the command: what "
                "the joint does between them is not known; record ten times as fast"
            )
            yield records.Remark(records.RemarkKind.SLOW, joint.name, tuple(coarse), text, rate_Hz, unit="Hz")


def _is_coarse(samples: records.Samples, joint: RobotJoint) -> bool:
    """Tell whether a joint moves with a command that has fewer than nine samples a wave.

    The second differences of a command, which has no noise, are then as large as noise of a tenth of its
    range: for a sine of n samples a wave the ratio of range to this noise is 1.17 / sin(pi / n)^2, and 10 at
    n = 9. What lies between the samples is then off the straight line by up to 6 % of the amplitude.
    """
    sent, least_rad = samples.command[np.isfinite(samples.command)], records.COARSE_RAD * joint.per_rad
    is_moving = min(records.span(sent), records.span(samples.position)) > least_rad
    return is_moving and records.span(sent) < SPREAD * _noise_rad(sent)


def _noise_rad(position: Array) -> float:
    """Return the standard deviation of white noise, whose second differences have six times its variance."""
    return records.robust_sigma(np.diff(position, 2)) / math.sqrt(6.0)


BEGINS: Final = 3.0
"""Ratio of the error before a joint starts to the largest later one from which it was not on yet."""


def find_late_starts(robot: Robot, motions: Sequence[Motion]) -> Iterator[records.Remark]:
    """Find joints that stand still at the start of a motion while their commands move."""
    for joint in (one for one in robot.joints if one.mode is ControlMode.POSITION):
        own = records.samples_of(motions, joint.name)
        starts = {name: _late_start_s(one, records.COARSE_RAD * joint.per_rad) for name, one in own.items()}
        late_s = {name: one for name, one in starts.items() if one}
        if late_s:
            longest = max(late_s.values())
            text = (
                f"the joint stands still for the first {longest:.2g} s while its command moves, and follows "
                "it later: was the motor off? Begin the motion later, or name the signal enabled"
            )
            yield records.Remark(records.RemarkKind.START, joint.name, tuple(late_s), text, longest, unit="s")


def _late_start_s(samples: records.Samples, least_rad: float) -> float:
    """Return how long a joint does not move clearly at the start although its command does; 0 if it does."""
    use = np.isfinite(samples.command)
    time_s, position, command = samples.time_s[use], samples.position[use], samples.command[use]
    if time_s.size < WINDOW:
        return 0.0
    error = np.abs((command - command[0]) - (position - position[0]))
    starts = np.flatnonzero(np.abs(position - position[0]) > least_rad / records.STEPS)
    if not starts.size or not 0 < starts[0] < time_s.size // 2:
        return 0.0
    before, later = error[: starts[0]], error[2 * starts[0] :]
    is_late = before.max() > least_rad and before.max() > BEGINS * float(later.max(initial=0.0))
    return float(time_s[starts[0]] - time_s[0]) if is_late else 0.0
