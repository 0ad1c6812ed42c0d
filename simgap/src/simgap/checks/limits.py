"""Limits that a motion meets: clipped commands, joints that stop short, motors at their limit, contact."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import mujoco
import numpy as np

from simgap.arrays import Array, Flags
from simgap.checks.records import Remark, RemarkKind, hold, joint_samples, runs
from simgap.checks.static import Free, Rest, Stop, find_lower_stop, median_interval, visit_poses
from simgap.logs import JointLog, Motion
from simgap.robot import ControlMode, Robot, RobotJoint

AT_LIMIT: Final = 0.99
"""Share of a limit from which a motor is at it: sensors of torque and current are good to about 1 %."""
REMARK_SHARE: Final = 0.01
"""Share of the samples at a limit that is worth a remark."""
PLATEAU_RUN: Final = 5
"""Samples in a row at the very same largest value that make a plateau."""
STRONGER: Final = 1.05
"""A motor that lifted this much more elsewhere is not too weak: masses of models are good to about 5 %."""
SIGMAS_90: Final = 1.645
"""Half the width of a 90 % interval of a normal value, in standard deviations."""
PUSHES: Final = 3.0
"""Ratio to the median effort from which a motor pushes against something."""


def find_cut_offs(
    robot: Robot, motions: Sequence[Motion], rest: Rest, free: Free
) -> tuple[list[Remark], Flags, Flags]:
    """Find values at which the position of a joint stops although its command goes on.

    Returns:
        Remarks, and flags of the samples of `rest` at which a joint is held back, (n, n_joints): all, and
        those where its motor is strong enough. Where it may be too weak, effects of the catalogue explain it.
    """
    remarks: list[Remark] = []
    held, is_sure = np.zeros((2, *rest.measured.shape), np.bool_)
    for k, name in enumerate(rest.joints):
        slow = np.where(rest.is_slow[:, k], free.position[:, k], np.nan)
        for side in (1.0, -1.0):
            measured = side * rest.measured[:, k]
            stop = find_lower_stop(side * slow, measured, rest.motion, float(free.friction[k]))
            if stop is None:
                continue
            remarks.append(_cut_off(robot.joint(name), motions, rest, free, k, side, stop))
            with np.errstate(invalid="ignore"):
                below = side * free.position[:, k] < stop.levels.max()
            held[:, k] |= below
            is_sure[:, k] |= below & (remarks[-1].kind is RemarkKind.CUT_OFF)
    return remarks, held, is_sure


def _cut_off(
    joint: RobotJoint, motions: Sequence[Motion], rest: Rest, free: Free, k: int, side: float, stop: Stop
) -> Remark:
    """Describe a stop of one joint: a command that is cut off, or a motor that may be too weak."""
    numbers = [int(rest.motion[begin]) for begin, _ in stop.excursions]
    names = tuple(dict.fromkeys(motions[number].name for number in numbers))
    at = np.concatenate([np.arange(b, e)[stop.is_sure[b:e]] for b, e in stop.excursions])
    value = side * stop.furthest + float(np.median(free.offset[at, k]))
    band = max(float(free.friction[k]), SIGMAS_90 * stop.noise)
    others = side * stop.levels - side * stop.furthest + value
    interval = (float(min(others.min(), value - band)), float(max(others.max(), value + band)))
    furthest = side * float(np.min(side * rest.command[at, k]))
    count = f"{len(stop.excursions)} times"
    stops, goes_on = joint.show(value, ".3f"), joint.show(furthest, ".3f")
    low, high = (joint.show(one, ".3f").split()[0] for one in interval)
    if _may_be_too_weak(joint, rest, k, side, at):
        text = (
            f"the position stops at {stops}, the command goes on to {goes_on}, {count}; "
            "gravity is against it, so a torque limit and a command that is cut off look alike"
        )
        return Remark(RemarkKind.SATURATION, joint.name, names, text, value, interval, joint.unit)
    text = (
        f"the position stops at {stops} ({low} to {high}), {count}, while the "
        f"command goes on to {goes_on}{_effort_words(joint.name, motions, rest, at)}"
    )
    return Remark(RemarkKind.CUT_OFF, joint.name, names, text, value, interval, joint.unit)


def _may_be_too_weak(joint: RobotJoint, rest: Rest, k: int, side: float, at: Array) -> bool:
    """Return whether gravity pulls back as hard as anywhere that the joint went towards its command."""
    if not joint.is_loaded_by_gravity:
        return False
    needed = -side * rest.gravity_Nm[:, k]  # positive: the motor has to work towards the command
    here = float(np.median(needed[at]))
    step = -side * np.diff(rest.measured[:, k], prepend=np.nan)
    is_lifting = rest.is_slow[:, k] & (step > 0.0)
    is_lifting[at] = False
    return here > 0.0 and float(np.max(needed[is_lifting], initial=0.0)) < STRONGER * here


def _effort_words(joint: str, motions: Sequence[Motion], rest: Rest, at: Array) -> str:
    """Say if the motor pushes there: then a mechanical stop is likely, and not a limit of the command."""
    inside, outside = [], []
    for number, motion in enumerate(motions):
        log = motion.joints[joint]
        signal = log.torque or log.current
        if signal is None:
            return ""
        own = np.flatnonzero(rest.motion == number)
        size = np.abs(hold(signal, rest.time_s[own]))
        is_at = np.isin(own, at)
        inside.append(size[is_at & np.isfinite(size)])
        outside.append(size[~is_at & np.isfinite(size)])
    at_stop, elsewhere = np.concatenate(inside), np.concatenate(outside)
    if not at_stop.size or not elsewhere.size:
        return ""
    here, usual = float(np.median(at_stop)), float(np.median(elsewhere))
    what = "torque" if motions[0].joints[joint].torque is not None else "current"
    if here > PUSHES * usual:
        much = f"{here / usual:.0f} times the usual there" if usual > 0.0 else "0 elsewhere"
        return f"; its {what} is {much}, as against a hard stop"
    return f"; its {what} is not larger there"


def find_saturation(robot: Robot, motions: Sequence[Motion]) -> Iterator[Remark]:
    """Find motors that are at their limit of torque, current or command for a share of the time."""
    for joint in robot.joints:
        efforts = {one.name: _effort(joint, one) for one in motions if joint.name in one.joints}
        limits = {what: limit for what, limit, _ in efforts.values()}
        values = {name: np.abs(value[np.isfinite(value)]) for name, (_, _, value) in efforts.items()}
        every = np.concatenate([np.zeros(0), *values.values()])
        if len(limits) != 1 or not every.size:
            continue
        ((what, limit),) = limits.items()
        limit = limit if math.isfinite(limit) else _plateau(list(values.values()))
        at_limit = {name: float(np.mean(one >= AT_LIMIT * limit)) for name, one in values.items() if one.size}
        names = tuple(name for name, share in at_limit.items() if share > REMARK_SHARE)
        if math.isfinite(limit) and names:
            share = float(np.mean(every >= AT_LIMIT * limit))
            text = f"the {what} is at its limit of {limit:.4g} in {share:.1%} of the samples"
            yield Remark(RemarkKind.SATURATION, joint.name, names, text, limit)


def _effort(joint: RobotJoint, motion: Motion) -> tuple[str, float, Array]:
    """Return the name of the effort of a motor, its limit, and its values, (n,)."""
    log = motion.joints[joint.name]
    if log.torque is not None:
        return "torque", joint.torque_limit_Nm, log.torque.value
    if log.current is not None:
        return "current", joint.torque_limit_Nm / joint.torque_constant_Nm_A, log.current.value
    if joint.mode is ControlMode.POSITION and joint.is_known:
        return "torque by the model", joint.torque_limit_Nm, _servo_torque_Nm(joint, log, motion)
    if joint.mode in (ControlMode.TORQUE, ControlMode.CURRENT) and log.command is not None:
        return "command", math.inf, log.command.value
    return "", math.inf, np.zeros(0)


def _servo_torque_Nm(joint: RobotJoint, log: JointLog, motion: Motion) -> Array:
    """Return the torque that the command would give without a limit, (n,)."""
    samples = joint_samples(log)
    error = samples.command - samples.position
    speed = np.gradient(samples.position, samples.time_s) if samples.time_s.size > 1 else np.zeros(error.size)
    return joint.kp_Nm_rad * motion.gain.get(joint.name, 1.0) * error - joint.kd_Nms_rad * speed


def _plateau(values: Sequence[Array]) -> float:
    """Return the largest value if the signal stays at it exactly, and is rarely just below it; else NaN."""
    largest = max(float(value.max(initial=0.0)) for value in values)
    if largest == 0.0:
        return math.nan
    at_top = [value >= largest * (1.0 - 1e-9) for value in values]
    longest = max((end - begin for one in at_top for begin, end in runs(one)), default=0)
    n_top = sum(int(one.sum()) for one in at_top)
    near = [(value >= 0.95 * largest) & ~one for value, one in zip(values, at_top, strict=True)]
    is_plateau = longest >= PLATEAU_RUN and n_top > sum(int(one.sum()) for one in near)
    return largest if is_plateau else math.nan


def find_plane(
    robot: Robot, motions: Sequence[Motion], rest: Rest, free: Free, is_held: Flags
) -> tuple[list[Remark], Flags]:
    """Find a horizontal plane at which the tool site stops.

    Args:
        robot: Robot; without a tool site nothing is found.
        is_held: Samples at which a joint is held back by something else, (n,).

    Returns:
        A remark if there is a plane, and flags of the samples whose free pose is below it, (n,).
    """
    nothing: tuple[list[Remark], Flags] = ([], np.zeros(rest.time_s.size, np.bool_))
    chain = chain_joints(robot)
    if not chain or not set(chain) <= set(rest.joints):
        return nothing
    if any(robot.joint(name).mode is not ControlMode.POSITION for name in chain):
        return nothing
    columns = [rest.joints.index(name) for name in chain]
    measured = site_heights(robot, rest.joints, rest.measured)
    pose = rest.measured.copy()
    pose[:, columns] = free.position[:, columns]
    lowered = site_heights(robot, rest.joints, pose)
    use = rest.is_slow[:, columns].all(axis=1) & ~is_held
    stop = find_lower_stop(np.where(use, lowered, np.nan), measured, rest.motion, 0.0)
    if stop is None:
        return nothing
    numbers = np.unique(rest.motion[stop.is_sure])
    levels = np.array([np.median(measured[stop.is_sure & (rest.motion == k)]) for k in numbers])
    names = tuple(motions[k].name for k in numbers)
    value, interval = float(np.median(levels)), median_interval(levels)
    text = (
        f"{robot.tool_site} stops at z = {value * 1e3:.0f} mm ({interval[0] * 1e3:.0f} to "
        f"{interval[1] * 1e3:.0f}) in {len(names)} motions, while the commands go on to "
        f"{float(lowered[stop.is_sure].min()) * 1e3:.0f} mm"
    )
    with np.errstate(invalid="ignore"):
        is_below = lowered < levels.max()
    return [Remark(RemarkKind.CONTACT, "", names, text, value, interval, "m")], is_below


def chain_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints of the robot between the world and the tool site."""
    model = robot.model
    if not robot.tool_site:
        return ()
    body, bodies = int(model.site_bodyid[model.site(robot.tool_site).id]), set()
    while body > 0:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return tuple(one.name for one in robot.joints if int(model.dof_bodyid[one.dof_index]) in bodies)


def site_heights(robot: Robot, joints: Sequence[str], q_rad: Array) -> Array:
    """Return the height of the tool site against gravity, (n,) [m]; NaN at poses (n, n_joints) with NaN."""
    gravity, site = robot.model.opt.gravity, robot.model.site(robot.tool_site).id
    strength = float(np.linalg.norm(gravity))
    up = -gravity / strength if strength > 0.0 else np.array([0.0, 0.0, 1.0])
    height = np.full(q_rad.shape[0], np.nan)
    for row, data in visit_poses(robot, joints, q_rad):
        height[row] = data.site_xpos[site] @ up
    return height


EVERY: Final = 4
"""One of so many samples is tried: contacts last longer than a fifth of a second."""
LEAST_DEPTH_M: Final = 1e-3
"""Bodies that go into each other by less may just touch."""


def find_collisions(robot: Robot, motions: Sequence[Motion], rest: Rest) -> Iterator[Remark]:
    """Return a remark for each pair of bodies that go into each other at measured poses."""
    model = robot.model
    if not np.any(model.geom_contype) or not np.any(model.geom_conaffinity):
        return
    where: dict[tuple[str, str], list[str]] = {}
    tried = rest.motion[::EVERY]
    for row, data in visit_poses(robot, rest.joints, rest.measured[::EVERY]):
        mujoco.mj_collision(model, data)
        for pair in {_bodies(model, one.geom) for one in data.contact if one.dist < -LEAST_DEPTH_M}:
            where.setdefault(pair, []).append(motions[int(tried[row])].name)
    for (one, other), names in sorted(where.items(), key=lambda item: -len(item[1])):
        share = len(names) / tried.size
        text = f"{one} goes into {other} in {share:.1%} of the measured poses"
        yield Remark(RemarkKind.COLLISION, "", tuple(dict.fromkeys(names)), text, share)


def _bodies(model: mujoco.MjModel, geoms: Sequence[int]) -> tuple[str, str]:
    names = sorted(model.body(int(model.geom_bodyid[geom])).name or "a body" for geom in geoms)
    return names[0], names[1]
