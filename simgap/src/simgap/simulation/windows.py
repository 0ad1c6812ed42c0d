"""Windows: parts of a motion that are simulated from a measured start, and sampled at the measured times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.common.errors import RobotError
from simgap.logs import JointLog, Motion, Signal, Usable
from simgap.robot import Robot

LEAD_S: Final = 0.25
"""Command before the start of a window, for delays and limits that remember it. Longer delays are no delays
of a servo."""
SLOPE_SAMPLES: Final = 5
"""Samples of the straight line that gives the velocity: the fewest that halve the noise of two samples."""


@dataclass(frozen=True, slots=True)
class Window:
    """A part of a motion, with all that its simulation needs. Times begin at its start."""

    motion: str
    start_s: float
    """Start in the time of the motion."""
    q_rad: Array
    """Measured positions at the start, (n_joints,)."""
    v_rad_s: Array
    """Measured velocities at the start, (n_joints,)."""
    command: Array
    """Means of the held command over each control period, (n_lead + n_ticks, n_joints)."""
    n_lead: int
    """Control periods before the start."""
    enabled: Flags
    """True in the control periods in which the motor has torque, (n_ticks, n_joints)."""
    gain: Array
    """Factor on kp, (n_joints,)."""
    temperature_degC: Array
    """Mean temperatures, (n_joints,); NaN where not logged."""
    sample_time_s: tuple[Array, ...]
    """Times of the positions of each joint, (n,) each."""
    measured_rad: tuple[Array, ...]
    """Measured positions of each joint, (n,) each."""

    @property
    def n_ticks(self) -> int:
        """Number of control periods that are simulated."""
        return int(self.command.shape[0]) - self.n_lead


def cut_windows(
    robot: Robot, motion: Motion, window_s: float | None, spacing_s: float, keep: Usable | None = None
) -> list[Window]:
    """Cut a motion into windows; RobotError if a joint has no log, no command, or too few positions.

    A new window begins after a stretch of samples that are not used, if it is longer than LEAD_S. Without a
    length `window_s`, a window lasts until the next such stretch. Samples of a joint that are kept are at
    least `spacing_s` apart.
    """
    logs = [_checked(motion, joint.name) for joint in robot.joints]
    begin_s = max(log.position.time_s[0] for log in logs)
    end_s = min(log.position.time_s[-1] for log in logs)
    if end_s <= begin_s:
        raise RobotError(f"motion {motion.name}: the positions of its joints have no common time")
    flags = [
        (keep or {}).get((motion.name, joint.name), np.ones(log.position.time_s.size, dtype=bool))
        for log, joint in zip(logs, robot.joints, strict=True)
    ]
    masks = [_spaced(log.position.time_s, spacing_s, one) for log, one in zip(logs, flags, strict=True)]
    edges_s = _edges(begin_s, _restarts(logs, flags, begin_s, end_s), end_s, window_s)
    return [_window(robot, motion, logs, masks, low, high) for low, high in pairwise(edges_s)]


def keep_beginning(window: Window, period_s: float) -> Window:
    """Return a window that ends after SLOPE_SAMPLES samples of each joint, and a delay of LEAD_S."""
    times_s = tuple(one[:SLOPE_SAMPLES] for one in window.sample_time_s)
    end_s = max((float(one[-1]) for one in times_s if one.size), default=0.0)
    n_ticks = min(window.n_ticks, int((end_s + LEAD_S) / period_s) + 1)
    return replace(
        window,
        command=window.command[: window.n_lead + n_ticks],
        enabled=window.enabled[:n_ticks],
        sample_time_s=times_s,
        measured_rad=tuple(one[:SLOPE_SAMPLES] for one in window.measured_rad),
    )


def _edges(begin_s: float, restarts_s: Array, end_s: float, window_s: float | None) -> list[float]:
    """Return the edges of windows, in which each part between restarts has a whole number of windows [s]."""
    edges_s = [begin_s]
    for high_s in np.append(restarts_s, end_s):
        low_s, length_s = edges_s[-1], window_s or end_s - begin_s
        edges_s.extend(low_s + length_s * np.arange(1, round((high_s - low_s) / length_s)))
        edges_s.append(high_s)
    return edges_s


def _restarts(logs: list[JointLog], flags: list[Flags], begin_s: float, end_s: float) -> Array:
    """Return the ends of stretches of samples that are not used, of all joints [s].

    What makes samples useless for long, as a table does, leaves the joint where friction holds it. No effect
    of the robot explains this position.
    """
    ends_s = []
    for log, used in zip(logs, flags, strict=True):
        time_s, k = log.position.time_s, np.flatnonzero(used)
        last_s = np.append(time_s[0], time_s[k[:-1]])
        ends_s.extend(time_s[k][(np.diff(k, prepend=-1) > 1) & (time_s[k] - last_s > LEAD_S)])
    found_s = np.unique(ends_s)
    # joints that were stopped together are used again within a few samples: the last one counts
    is_last = np.diff(found_s, append=end_s) > LEAD_S
    return found_s[is_last & (found_s > begin_s)]


def _checked(motion: Motion, joint: str) -> JointLog:
    log = motion.joints.get(joint)
    if log is None or log.command is None:
        raise RobotError(
            f"motion {motion.name}: joint {joint} has no command, and a simulation needs one for every joint"
        )
    if log.position.time_s.size < SLOPE_SAMPLES:
        raise RobotError(
            f"motion {motion.name}: joint {joint} has {log.position.time_s.size} positions, "
            f"at least {SLOPE_SAMPLES} are needed"
        )
    return log


def _window(
    robot: Robot, motion: Motion, logs: list[JointLog], masks: list[Flags], low_s: float, high_s: float
) -> Window:
    period_s = robot.control_period_s
    n_lead = round(LEAD_S / period_s)
    n_ticks = max(1, int(np.ceil((high_s - low_s) / period_s - 1e-9)))
    starts = [local_line(log.position, low_s) for log in logs]
    # a step of the integrator uses the force at its beginning for the whole of it: half a step earlier, the
    # command acts at its own time, and the error falls with the square of the step
    middle_s = low_s - 0.5 * float(robot.model.opt.timestep)
    edges_s: Array = middle_s + period_s * np.arange(-n_lead, n_ticks + 1, dtype=float)
    times, values = [], []
    for log, mask in zip(logs, masks, strict=True):
        time_s = log.position.time_s
        inside = mask & (time_s >= low_s) & (time_s < high_s if high_s < time_s[-1] else time_s <= high_s)
        times.append(time_s[inside] - low_s)
        values.append(log.position.value[inside])
    return Window(
        motion=motion.name,
        start_s=low_s,
        q_rad=np.array([value for value, _ in starts]),
        v_rad_s=np.array([slope for _, slope in starts]),
        command=np.stack([held_means(log.command, edges_s) for log in logs if log.command], axis=1),
        n_lead=n_lead,
        enabled=np.stack([_enabled(log, edges_s[n_lead:]) for log in logs], axis=1),
        gain=np.array([motion.gain.get(joint.name, 1.0) for joint in robot.joints]),
        temperature_degC=np.array([_mean(log.temperature, low_s, high_s) for log in logs]),
        sample_time_s=tuple(times),
        measured_rad=tuple(values),
    )


def held_means(signal: Signal, edges_s: Array) -> Array:
    """Average a signal, held between its samples, between increasing edges, (n + 1,) [s]; return means, (n,).

    The mean over a control period keeps the time of a step of the command exactly. A command that is sampled
    at the beginning of periods would arrive half a period late. Edges have equal distances. Before its first
    sample a signal has the value of the first. Where it does not change in a period, the mean has the bits of
    its value.
    """
    index = np.clip(np.searchsorted(signal.time_s, edges_s[:-1], side="right") - 1, 0, None)
    means = signal.value[index].astype(float)
    inside = (signal.time_s > edges_s[0]) & (signal.time_s < edges_s[-1])
    inside[0] = False
    step_s = signal.time_s[inside]
    k = np.searchsorted(edges_s, step_s, side="right") - 1
    share = (edges_s[k + 1] - step_s) / (edges_s[1] - edges_s[0])
    jump = np.diff(signal.value, prepend=signal.value[:1])[inside]
    is_within = edges_s[k] < step_s
    np.add.at(means, k[is_within], (jump * share)[is_within])
    return means


def local_line(signal: Signal, time_s: float) -> tuple[float, float]:
    """Fit a line to the nearest of at least SLOPE_SAMPLES samples; return value and slope [1/s] at a time."""
    nearest = np.searchsorted(signal.time_s, time_s)
    first = int(np.clip(nearest - SLOPE_SAMPLES // 2, 0, signal.time_s.size - SLOPE_SAMPLES))
    part = slice(first, first + SLOPE_SAMPLES)
    t = signal.time_s[part] - signal.time_s[part].mean()
    slope = float(t @ signal.value[part] / (t @ t))
    return float(signal.value[part].mean() + slope * (time_s - signal.time_s[part].mean())), slope


def _spaced(time_s: Array, spacing_s: float, keep: Flags) -> Flags:
    """Keep at most one sample in each interval of this length."""
    chosen = keep.copy()
    # a hundredth of the spacing is the jitter of stamps at the same rate
    last = -np.inf
    for i in np.flatnonzero(chosen):
        if time_s[i] - last < 0.99 * spacing_s:
            chosen[i] = False
        else:
            last = time_s[i]
    return chosen


def _enabled(log: JointLog, edges_s: Array) -> Flags:
    """Return in which periods the motor has torque for the longer part, so that a switch is not late."""
    if log.enabled is None:
        return np.ones(edges_s.size - 1, dtype=bool)
    is_on = Signal(log.enabled.time_s, (log.enabled.value > 0.5).astype(float))
    return np.asarray(held_means(is_on, edges_s) > 0.5)


def _mean(signal: Signal | None, low_s: float, high_s: float) -> float:
    if signal is None:
        return float("nan")
    inside = (signal.time_s >= low_s) & (signal.time_s <= high_s)
    return float(np.mean(signal.value[inside] if inside.any() else signal.value))


@dataclass(frozen=True, slots=True)
class _Series:
    """Samples of one joint in one window."""

    sims: slice
    joint: int
    column: int
    """Place of the first sample in the values."""
    index: Integers
    """Control periods in which they are taken, (1 or n_candidates, n), not decreasing."""
    share: Array
    """Shares of the period that have passed."""


class Sampling:
    """Take samples from a path that is simulated part by part."""

    def __init__(
        self, windows: Sequence[Window], order: Sequence[int], late_s: Array, period_s: float
    ) -> None:
        """Find the control period of each sample, by its delays, (n_windows, n_candidates, n_joints) [s]."""
        n_candidates = late_s.shape[1]
        counts = np.zeros((len(windows), late_s.shape[2]), dtype=np.int64)
        for w, place in enumerate(order):
            counts[place] = [one.size for one in windows[w].sample_time_s]
        columns = np.cumsum([0, *counts.ravel()])
        self.values: Array = np.empty((n_candidates, columns[-1]))
        """Sampled positions, (n_candidates, n_samples) [rad]."""
        self._series = []
        for w, window in enumerate(windows):
            for j, time_s in enumerate(window.sample_time_s):
                late = late_s[w, :, j]
                late = late[:1] if np.all(late == late[0]) else late
                position = np.clip((time_s - late[:, None]) / period_s, 0.0, window.n_ticks)
                index = np.minimum(position.astype(np.int64), window.n_ticks - 1)
                sims = slice(w * n_candidates, (w + 1) * n_candidates)
                column = int(columns[order[w] * late_s.shape[2] + j])
                self._series.append(_Series(sims, j, column, index, position - index))

    def take(self, path: Array, first: int, last: int) -> None:
        """Interpolate samples in positions at period ends, (over last - first, n_sims, n_joints) [rad]."""
        for one in self._series:
            n_candidates = one.sims.stop - one.sims.start
            for row, index in enumerate(one.index):
                low, high = np.searchsorted(index, [first, last])
                if low == high:
                    continue
                k = index[low:high] - first
                is_common = one.index.shape[0] == 1
                part = slice(0, n_candidates) if is_common else slice(row, row + 1)
                q = path[:, one.sims, one.joint][:, part]
                share = one.share[row, low:high, None]
                value = q[k] + share * (q[k + 1] - q[k])
                self.values[part, one.column + low : one.column + high] = value.T
