"""Which command a position follows: that of its own joint and motion, or another one."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from simgap.checks.records import COARSE_RAD, Remark, RemarkKind, samples_of, span
from simgap.logs import Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint

BETTER: Final = 0.5
"""Ratio of two RMS errors from which another command is the better one: the chance that two that fit equally
well differ as much is below 1e-6 from 100 independent samples on."""


def count_foreign_commands(pairs: Sequence[tuple[Signal, Signal]]) -> int:
    """Count motions whose position follows the command of another motion twice as well as their own.

    Two distances count: that from the command itself, and that beside the best offset and gain.
    The second is needed because a weak servo hangs below its command.
    """
    if not pairs:
        return 0
    errors = np.array(
        [
            [_follow_errors(one, other, float(other.time_s[0] - one.time_s[0])) for _, other in pairs]
            for one, _ in pairs
        ]
    )
    own = np.diagonal(errors).T  # (n_motions, 2)
    return int(np.sum((errors.min(axis=1) < BETTER * own).any(axis=1)))


def find_exchanged(robot: Robot, motions: Sequence[Motion]) -> Iterator[Remark]:
    """Find joints whose positions follow the command of another joint better than their own."""
    names = [one.name for one in robot.joints if one.mode is ControlMode.POSITION and _moves(one, motions)]
    own = [motion for motion in motions if all(_is_commanded(motion, name) for name in names)]
    if len(names) < 2 or not own:
        return
    errors = np.array([[_pooled_error(own, one, other) for other in names] for one in names])
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
            yield Remark(RemarkKind.ORDER, name, motion_names, text, errors[k, best], unit=joint.unit)


LEADS_S: Final = 0.01 * np.arange(-30, 31)
"""Times that are tried; those below 0 are lags, which a wave of up to 0.3 s shows as leads too."""
MAX_SAMPLES: Final = 5000
"""Samples of a motion that are compared at each of them: they are more than BETTER needs."""


def find_leading(robot: Robot, motions: Sequence[Motion]) -> Iterator[Remark]:
    """Find joints whose position is ahead of its command: no servo is, but columns or clocks may be wrong.

    Joints with torques are passed over: their torques are compared, and the command takes no part.
    """
    for joint in robot.joints:
        if joint.mode is not ControlMode.POSITION or not _moves(joint, motions):
            continue
        own = [motion for motion in motions if _is_commanded(motion, joint.name)]
        if all(motion.joints[joint.name].torque is not None for motion in own):
            continue
        errors = np.array([_pooled_error(own, joint.name, joint.name, lead_s) for lead_s in LEADS_S])
        lead_s = float(LEADS_S[int(np.argmin(errors))])
        if errors.min() < BETTER * errors[LEADS_S < 1e-9].min():
            text = (
                f"it leads by {lead_s:.2g} s: are the columns of command and position exchanged, or have "
                "they different clocks?"
            )
            names = tuple(motion.name for motion in own)
            yield Remark(RemarkKind.AHEAD, joint.name, names, text, lead_s, unit="s")


def find_unlike_repeats(robot: Robot, motions: Sequence[Motion]) -> Iterator[Remark]:
    """Find motions that are said to repeat another one, but whose positions are commanded otherwise.

    What differs between them would count as noise. Without commands, the positions are compared.
    """
    for joint in robot.joints:
        if joint.mode is not ControlMode.POSITION:
            continue
        first: dict[str, Signal] = {}
        unlike: list[str] = []
        for motion in motions:
            if not motion.repeat_of or joint.name not in motion.joints:
                continue
            log = motion.joints[joint.name]
            own = log.command or log.position
            short, long = sorted(
                (first.setdefault(motion.repeat_of, own), own), key=lambda one: one.time_s[-1]
            )
            varied = max(float(np.nanstd(short.value)), COARSE_RAD * joint.per_rad)
            if _follow_errors(short, long, 0.0)[0] > BETTER * varied:
                unlike.append(motion.name)
        if unlike:
            text = (
                "a motion and its repeats have other commands: does one label stand for different motions, "
                "in two files perhaps?"
            )
            yield Remark(RemarkKind.REPEATS, joint.name, tuple(unlike), text)


def _is_commanded(motion: Motion, joint: str) -> bool:
    return joint in motion.joints and motion.joints[joint].command is not None


def _moves(joint: RobotJoint, motions: Sequence[Motion]) -> bool:
    """Return whether position and command of a joint move in some motion."""
    least_rad = COARSE_RAD * joint.per_rad
    own = samples_of(motions, joint.name).values()
    return any(min(span(one.position), span(one.command)) > least_rad for one in own)


def _spread(motions: Sequence[Motion], joint: str) -> float:
    """Return the standard deviation of the positions of a joint within its motions."""
    own = samples_of(motions, joint).values()
    return math.sqrt(float(np.mean([np.var(one.position) for one in own])))


def _pooled_error(motions: Sequence[Motion], joint: str, other: str, lead_s: float = 0.0) -> float:
    """Return the RMS of positions, ahead by a time, beside a command whose offset and gain are fitted."""
    squares: list[float] = []
    for motion in motions:
        command = motion.joints[other].command
        assert command is not None
        position = motion.joints[joint].position
        few = slice(None, None, math.ceil(position.value.size / MAX_SAMPLES))
        position = Signal(position.time_s[few], position.value[few])
        squares.append(_follow_errors(position, command, lead_s)[1] ** 2)
    return math.sqrt(float(np.mean(squares)))


def _follow_errors(position: Signal, command: Signal, lead_s: float) -> tuple[float, float]:
    """Return the RMS of a position, ahead by a time, beside a command, and beside its best offset and gain.

    Both are infinite if the command covers less than half of the position.
    """
    time_s = position.time_s + lead_s
    sent = np.interp(time_s, command.time_s, command.value)
    use = (time_s >= command.time_s[0]) & (time_s <= command.time_s[-1])
    use &= np.isfinite(position.value) & np.isfinite(sent)
    if np.mean(use) <= 0.5:
        return math.inf, math.inf
    shown, sent = position.value[use], sent[use]
    distance = float(np.sqrt(np.mean((shown - sent) ** 2)))
    shown, sent = shown - shown.mean(), sent - sent.mean()
    norm = float(sent @ sent)
    gain = max(float(shown @ sent), 0.0) / norm if norm > 0.0 else 0.0
    return distance, float(np.sqrt(np.mean((shown - gain * sent) ** 2)))
