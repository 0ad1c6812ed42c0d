"""Which command a position follows: that of its own joint and motion, or another one."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from simgap.checks.records import COARSE_RAD, Remark, RemarkKind, joint_samples
from simgap.logs import Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint

BETTER: Final = 0.5
"""Ratio of two RMS errors from which another command is the better one: the chance that two that fit equally
well differ as much is below 1e-6 from 100 independent samples on."""


def count_foreign_commands(pairs: Sequence[tuple[Signal, Signal]]) -> int:
    """Count motions whose position follows the command of another motion better than their own.

    Two distances count: that from the command itself, and that beside the best offset and gain.
    The second is needed because a weak servo hangs below its command.

    Returns:
        Number of motions with one of these distances to another command below half of that to their own.
    """
    if not pairs:
        return 0
    errors = np.array([[_follow_errors(position, other) for _, other in pairs] for position, _ in pairs])
    own = np.diagonal(errors).T  # (n_motions, 2)
    return int(np.sum((errors.min(axis=1) < BETTER * own).any(axis=1)))


def find_exchanged(robot: Robot, motions: Sequence[Motion]) -> list[Remark]:
    """Find joints whose positions follow the command of another joint better than their own."""
    names = [one.name for one in robot.joints if one.mode is ControlMode.POSITION and _moves(one, motions)]
    own = [motion for motion in motions if all(_is_commanded(motion, name) for name in names)]
    if len(names) < 2 or not own:
        return []
    errors = np.array([[_pooled_error(own, one, other) for other in names] for one in names])
    found: list[Remark] = []
    for k, name in enumerate(names):
        best = int(np.argmin(errors[k]))
        if best != k and errors[k, best] < BETTER * min(errors[k, k], _spread(own, name)):
            joint = robot.joint(name)
            text = (
                f"the position follows the command of {names[best]} within "
                f"{joint.show_small(errors[k, best])}, its own only within {errors[k, k] * 1e3:.3g}: are the "
                "columns of two joints exchanged?"
            )
            motion_names = tuple(motion.name for motion in own)
            found.append(Remark(RemarkKind.ORDER, name, motion_names, text, errors[k, best], unit=joint.unit))
    return found


def _is_commanded(motion: Motion, joint: str) -> bool:
    return joint in motion.joints and motion.joints[joint].command is not None


def _moves(joint: RobotJoint, motions: Sequence[Motion]) -> bool:
    """Return whether position and command of a joint move in some motion."""
    name, least_rad = joint.name, COARSE_RAD * joint.per_rad
    samples = [joint_samples(motion.joints[name]) for motion in motions if _is_commanded(motion, name)]
    return any(
        one.position.size and min(np.ptp(one.position), np.nan_to_num(np.ptp(one.command))) > least_rad
        for one in samples
    )


def _spread(motions: Sequence[Motion], joint: str) -> float:
    """Return the standard deviation of the positions of a joint within its motions."""
    positions = [joint_samples(motion.joints[joint]).position for motion in motions]
    return math.sqrt(float(np.mean([np.var(one) for one in positions if one.size])))


def _pooled_error(motions: Sequence[Motion], joint: str, other: str) -> float:
    """Return the RMS of positions beside another command, whose offset and gain are fitted in each motion."""
    squares: list[float] = []
    for motion in motions:
        command = motion.joints[other].command
        assert command is not None
        squares.append(_follow_errors(motion.joints[joint].position, command)[1] ** 2)
    return math.sqrt(float(np.mean(squares)))


def _follow_errors(position: Signal, command: Signal) -> tuple[float, float]:
    """Return the RMS of a position beside a command, and beside its best offset and positive gain.

    Both are infinite if the command covers less than half of the position.
    """
    time_s = position.time_s - position.time_s[0] + command.time_s[0]
    sent = np.interp(time_s, command.time_s, command.value)
    use = (time_s <= command.time_s[-1]) & np.isfinite(position.value) & np.isfinite(sent)
    if np.mean(use) <= 0.5:
        return math.inf, math.inf
    shown, sent = position.value[use], sent[use]
    distance = float(np.sqrt(np.mean((shown - sent) ** 2)))
    shown, sent = shown - shown.mean(), sent - sent.mean()
    norm = float(sent @ sent)
    gain = max(float(shown @ sent), 0.0) / norm if norm > 0.0 else 0.0
    return distance, float(np.sqrt(np.mean((shown - gain * sent) ** 2)))
