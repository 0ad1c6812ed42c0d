"""Free positions: where a position-controlled joint would be at rest, and values at which something stops.

A joint is in a free static position if gravity, friction and its law of control agree with it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import mujoco
import numpy as np
from scipy.stats import binom

from simgap.arrays import Array, Flags, Integers
from simgap.checks.records import hold, joint_samples, robust_sigma, runs, span
from simgap.files.columns import SETTLING_S
from simgap.logs import Motion, Signal
from simgap.mjcf import place_tied
from simgap.robot import ControlMode, Robot

PERIOD_S: Final = 0.05
"""Period of the samples here: slow motion needs no finer one."""
SLOW_SHARE: Final = 0.2
"""A joint is slow while its command moves by less than this share of its travel in the settling time: a term
for the lag in proportion to the speed is then enough. From 0.1 to 0.4 the results change by under 1 %."""
LEAST_SLOW: Final = 100
"""Least number of slow samples; four numbers are fitted to them."""
ITERATIONS: Final = 50
"""Iterations of the reweighted fit: they converge by a factor of about two each."""


@dataclass(frozen=True, slots=True)
class Rest:
    """Slow samples of all motions, in order, at the joints of the robot that all motions log."""

    joints: tuple[str, ...]
    motion: Integers
    """Index of the motion of each sample, (n,)."""
    time_s: Array
    measured: Array
    """(n, n_joints) [rad]."""
    command: Array
    """(n, n_joints); NaN without a command."""
    gravity_Nm: Array
    """Torque that holds the arm against gravity, (n, n_joints)."""
    is_slow: Flags
    """Samples at which a prediction is as good as for rest, (n, n_joints)."""
    direction: Array
    """Sign of the last change of the command, (n, n_joints)."""
    speed: Array
    """Mean rate of the command over the settling time, (n, n_joints)."""


@dataclass(frozen=True, slots=True)
class Free:
    """Free positions of slow samples."""

    position: Array
    """Predicted position, (n, n_joints) [rad]; NaN where it cannot be predicted."""
    offset: Array
    """Command less free position, without friction and lag, (n, n_joints) [rad]."""
    friction: Array
    """Half the hysteresis between the directions at rest, (n_joints,) [rad]; 0 if not known."""


def find_rest(robot: Robot, motions: Sequence[Motion]) -> Rest:
    """Return the samples of all motions at a low rate."""
    joints = tuple(one.name for one in robot.joints if all(one.name in motion.joints for motion in motions))
    parts = [_resample(motion, joints) for motion in motions]
    measured = np.concatenate([part[1] for part in parts])
    command = np.concatenate([part[2] for part in parts])
    is_slow, direction, speed = _command_motion(parts)
    return Rest(
        joints=joints,
        motion=np.concatenate([np.full(part[0].size, k) for k, part in enumerate(parts)]),
        time_s=np.concatenate([part[0] for part in parts]),
        measured=measured,
        command=command,
        gravity_Nm=gravity_torques(robot, joints, measured),
        is_slow=is_slow & np.isfinite(command),
        direction=direction,
        speed=speed,
    )


def predict_free(robot: Robot, motions: Sequence[Motion], rest: Rest, is_held: Flags) -> Free:
    """Predict free positions, less exactly at fast samples, from those that nothing holds, (n, n_joints)."""
    free, offset = np.full_like(rest.measured, np.nan), np.zeros_like(rest.measured)
    friction = np.zeros(len(rest.joints))
    for k in range(len(rest.joints)):
        law = fit_static_law(robot, motions, rest, k, is_held[:, k])
        if law is None:
            continue
        free[law.known, k] = rest.command[law.known, k] - law.columns[law.known] @ law.weight
        offset[law.known, k] = law.columns[law.known, :2] @ law.weight[:2]
        friction[k] = abs(law.weight[2]) / law.gain
    return Free(free, offset, friction)


@dataclass(frozen=True, slots=True)
class StaticLaw:
    """Command less position of a joint at rest, in proportion to some terms."""

    known: Flags
    """Samples with a command, (n,)."""
    columns: Array
    """Gravity torque, 1, direction and speed, (n, 4); the first and third over the gain column."""
    weight: Array
    """(4,); the first is one over the gain [rad/(N m)]."""
    gain: float
    """Median of the gain column."""
    error: Array
    """Command less position at the samples that were fitted."""
    load_Nm: Array
    """Gravity torque over the gain column there."""


def fit_static_law(
    robot: Robot, motions: Sequence[Motion], rest: Rest, k: int, is_held: Flags
) -> StaticLaw | None:
    """Fit the law of joint k of `rest` to slow samples that nothing holds, (n,); None if it has too few."""
    joint = robot.joint(rest.joints[k])
    gain = np.array([motion.gain.get(joint.name, 1.0) for motion in motions])[rest.motion]
    known = np.isfinite(rest.command[:, k]) & (gain > 0.0)
    use = known & rest.is_slow[:, k] & ~is_held
    if joint.mode is not ControlMode.POSITION or use.sum() < LEAST_SLOW:
        return None
    gain = np.where(known, gain, 1.0)
    load = rest.gravity_Nm[:, k] / gain * joint.is_loaded_by_gravity
    columns = np.stack([load, np.ones(load.size), rest.direction[:, k] / gain, rest.speed[:, k]], axis=1)
    error = (rest.command - rest.measured)[use, k]
    weight = _fit_absolute(columns[use], error)
    return StaticLaw(known, columns, weight, float(np.median(gain[use])), error, load[use])


def visit_poses(robot: Robot, joints: Sequence[str], q_rad: Array) -> Iterator[tuple[int, mujoco.MjData]]:
    """Yield the row of each finite pose, (n, n_joints) [rad], and the model placed there."""
    model, data = robot.model, mujoco.MjData(robot.model)
    places = [robot.joint(name).qpos_index for name in joints]
    dofs = [robot.joint(name).dof_index for name in joints]
    for row in np.flatnonzero(np.isfinite(q_rad).all(axis=1)):
        data.qpos[places] = q_rad[row]
        place_tied(model, dofs, data.qpos, data.qvel)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        yield int(row), data


def gravity_torques(robot: Robot, joints: Sequence[str], q_rad: Array) -> Array:
    """Return the torques that hold the arm against gravity, (n, n_joints) [N m], at (n, n_joints) [rad]."""
    dofs = [robot.joint(name).dof_index for name in joints]
    torque, held = np.zeros(q_rad.shape), np.zeros(robot.model.nv)
    for row, data in visit_poses(robot, joints, q_rad):
        mujoco.mj_comVel(robot.model, data)
        mujoco.mj_rne(robot.model, data, 0, held)
        torque[row] = held[dofs]
    return torque


def _resample(motion: Motion, joints: Sequence[str]) -> tuple[Array, Array, Array]:
    """Return times (n,), positions and commands (n, n_joints) of a motion at the low rate."""
    samples = [joint_samples(motion.joints[name]) for name in joints]
    if not samples or any(one.time_s.size < 2 for one in samples):
        return np.zeros(0), np.zeros((0, len(joints))), np.zeros((0, len(joints)))
    begin, end = max(one.time_s[0] for one in samples), min(one.time_s[-1] for one in samples)
    time_s = np.arange(begin, end, PERIOD_S)
    measured = np.stack([np.interp(time_s, one.time_s, one.position) for one in samples], axis=1)
    command = np.stack([hold(Signal(one.time_s, one.command), time_s) for one in samples], axis=1)
    return time_s, measured, command


def _command_motion(parts: Sequence[tuple[Array, Array, Array]]) -> tuple[Flags, Array, Array]:
    """Return flags of slow samples, the direction of the last change, and the speed, each (n, n_joints)."""
    every = np.concatenate([command for _, _, command in parts])
    travel = np.array([span(one) for one in every.T])
    slow, direction, speed = [], [], []
    width = round(SETTLING_S / PERIOD_S)
    for _, _, command in parts:
        before = np.concatenate([np.repeat(command[:1], width, axis=0), command])
        if command.shape[0] == 0:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(before, width + 1, axis=0)
        moved = windows.max(axis=-1) - windows.min(axis=-1)
        slow.append(moved <= SLOW_SHARE * travel)
        step = np.diff(before, axis=0)[width - 1 :]
        direction.append(_last_sign(step))
        speed.append((command - before[: command.shape[0]]) / SETTLING_S)
    shape = (0, every.shape[1])
    return (
        np.concatenate([np.zeros(shape, np.bool_), *slow]),
        np.concatenate([np.zeros(shape), *direction]),
        np.concatenate([np.zeros(shape), *speed]),
    )


def _last_sign(step: Array) -> Array:
    """Return the sign of the last step that was not zero, (n, n_joints); 0 before the first."""
    sign = np.sign(np.nan_to_num(step))
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(sign.shape[0])[:, None], 0), axis=0)
    return np.take_along_axis(sign, last, axis=0)


def _fit_absolute(columns: Array, target: Array) -> Array:
    """Return weights (k,) of columns (n, k) with the least sum of absolute errors of a target (n,)."""
    weight: Array = np.zeros(columns.shape[1])
    share: Array = np.ones(target.size)
    for _ in range(ITERATIONS):
        root = np.sqrt(share)
        weight = np.asarray(np.linalg.lstsq(columns * root[:, None], target * root, rcond=None)[0], float)
        error = np.abs(target - columns @ weight)
        share = np.asarray(1.0 / np.maximum(error, 1e-3 * float(np.mean(error)) + 1e-12))
    return weight


CANDIDATES: Final = 200
"""Values that are tried: the best of them is within half a percent of the travel."""
BEYOND: Final = 2.0
"""Standard deviations by which the free value is beyond a stop where something is surely held."""
DEPTH: Final = 4.0
"""Standard deviations that an excursion must go beyond: its slope is then known, as derived at MAX_SLOPE."""
MAX_SLOPE: Final = 0.3
"""Slope of measured over free values beyond a stop. Free motion has slope 1, or 0.57 where the free values
spread evenly over DEPTH sigmas and have an error of one: 16 / 12 / (16 / 12 + 1). A stop has slope 0."""
LEAST_EXCURSIONS: Final = 3
"""Excursions that must agree: two may be one coincidence repeated."""
MAX_PASSED: Final = 0.2
"""Samples that may pass a stop, over those whose free value does: 0 at a stop and 1 for free motion. A few do
because the site is not the point of contact, so that its height there changes with its direction."""
LEAST_SHARE: Final = 0.005
"""Least standard deviation as a share of the travel: with DEPTH, less than 2 % is not worth a remark."""
LEVEL: Final = 0.9


@dataclass(frozen=True, slots=True)
class Stop:
    """A lower stop of some quantity."""

    noise: float
    """Standard deviation of measured less free values where nothing stops."""
    is_sure: Flags
    """Samples whose free value is surely beyond it, (n,)."""
    excursions: tuple[tuple[int, int], ...]
    """Begin and end (exclusive) of the excursions that show it, in samples."""
    levels: Array
    """Median measured value of each of them."""
    furthest: float
    """That of the excursion that was commanded furthest beyond."""


def find_lower_stop(free: Array, measured: Array, motion: Integers, least_sigma: float) -> Stop | None:
    """Find a value below which the free value goes and the measured one does not, in several excursions.

    Args:
        free: Predicted values if nothing stops, (n,), any unit; NaN where not known.
        measured: Measured values, (n,), in the same unit.
        motion: Index of the motion of each sample, (n,); an excursion ends with its motion.
        least_sigma: Least standard deviation of the prediction to assume, in the same unit.
    """
    known = np.isfinite(free) & np.isfinite(measured)
    if known.sum() < LEAST_EXCURSIONS:
        return None
    noise = robust_sigma((measured - free)[known])
    sigma = max(noise, least_sigma, LEAST_SHARE * float(np.ptp(measured[known])))
    value = _best_level(free[known], measured[known])
    beyond = np.where(known, value - free, -np.inf)
    is_sure = beyond > BEYOND * sigma
    if np.sum(measured[known] < value - BEYOND * sigma) > MAX_PASSED * is_sure.sum():
        return None
    every = _excursions(beyond > 0.0, motion)
    found = [one for one in every if _is_stopped(free[slice(*one)], measured[slice(*one)], value, sigma)]
    if len(found) < LEAST_EXCURSIONS:
        return None
    levels = np.array([np.median(measured[b:e][is_sure[b:e]]) for b, e in found])
    deepest = int(np.argmin([free[b:e].min() for b, e in found]))
    return Stop(noise, is_sure, tuple(found), levels, float(levels[deepest]))


def median_interval(values: Array) -> tuple[float, float]:
    """Return the 90 % interval of the median from the order of values (n,); all of them if they are few."""
    ordered = np.sort(values)
    cut = 0
    while 2 * (cut + 1) < ordered.size and binom.cdf(cut, ordered.size, 0.5) <= (1.0 - LEVEL) / 2.0:
        cut += 1
    cut = max(cut - 1, 0)
    return float(ordered[cut]), float(ordered[ordered.size - 1 - cut])


def _best_level(free: Array, measured: Array) -> float:
    """Return the level h with the least sum of |measured - max(free, h)|."""
    levels = np.linspace(measured.min(), np.median(measured), CANDIDATES)
    costs = [float(np.sum(np.abs(measured - np.maximum(free, level)))) for level in levels]
    return float(levels[int(np.argmin(costs))])


def _excursions(flags: Flags, motion: Integers) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for begin, end in runs(flags):
        cuts = [begin, *(begin + 1 + np.flatnonzero(np.diff(motion[begin:end]))), end]
        found += [(int(b), int(e)) for b, e in pairwise(cuts)]
    return found


def _is_stopped(free: Array, measured: Array, value: float, sigma: float) -> bool:
    """Return whether an excursion goes deep enough, and the measured value does not follow."""
    if value - free.min() < DEPTH * sigma:
        return False
    is_sure = free < value - BEYOND * sigma
    if np.median((measured - free)[is_sure]) < BEYOND * sigma:
        return False
    return free.size < 2 or float(np.cov(free, measured)[0, 1]) < MAX_SLOPE * float(np.var(free, ddof=1))
