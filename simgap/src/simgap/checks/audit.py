"""Audit of logs: remarks, units, samples that a diagnosis must not use, and the nominal model."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from simgap.arrays import Array, Flags
from simgap.checks.limits import chain_joints, find_collisions, find_cut_offs, find_plane, find_saturation
from simgap.checks.records import (
    Audit,
    Remark,
    RemarkKind,
    Samples,
    audit_rates,
    encoder_step_rad,
    find_constant_positions,
    hold,
    joint_samples,
    stale_flags,
)
from simgap.checks.static import Rest, find_rest, predict_free
from simgap.logs import JointLog, Logs, Motion
from simgap.result import Refusal
from simgap.robot import ControlMode, Robot
from simgap.simulation.compiled import compile_for, control_laws, nominal_gains

PASSES: Final = 2
"""The second pass predicts free positions without the samples that the first has found held back."""


def audit(robot: Robot, logs: Logs) -> Audit:
    """Audit logs against their robot.

    Stale and invalid samples, cut-off commands and contact with a plane are refused.
    """
    motions = logs.motions
    rates, remarks = audit_rates(motions)
    remarks += [*audit_units(robot, motions), *find_constant_positions(robot, motions)]
    rest = find_rest(robot, motions)
    held = np.zeros(rest.measured.shape, np.bool_)
    is_below = np.zeros(rest.time_s.size, np.bool_)
    chain = np.isin(rest.joints, chain_joints(robot))
    for _ in range(PASSES):
        free = predict_free(robot, motions, rest, held | (is_below[:, None] & chain))
        cut_offs, held = find_cut_offs(robot, motions, rest, free)
        contact, is_below = find_plane(robot, motions, rest, free, np.asarray(held.any(axis=1)))
    remarks += [*cut_offs, *contact, *find_saturation(robot, motions), *find_collisions(robot, motions, rest)]
    ranked = sorted(remarks, key=lambda one: list(RemarkKind).index(one.kind))
    reasons = {
        "command is cut off or the joint is too weak": held,
        "contact with a plane": is_below[:, None] & chain,
    }
    usable, refused = _refuse(motions, rest, reasons)
    return Audit(rates, tuple(ranked), refused, usable)


def _refuse(
    motions: Sequence[Motion], rest: Rest, reasons: Mapping[str, Flags]
) -> tuple[dict[tuple[str, str], Flags], tuple[Refusal, ...]]:
    """Return flags of usable position samples, and for each motion and reason how many rows are refused."""
    usable: dict[tuple[str, str], Flags] = {}
    refused: list[Refusal] = []
    step_rad = {name: encoder_step_rad(motions, name) for name in rest.joints}
    for number, motion in enumerate(motions):
        at = np.flatnonzero(rest.motion == number)
        count = dict.fromkeys([*reasons, "stale", "not finite"], 0)
        for name, log in motion.joints.items():
            samples, n = joint_samples(log), log.position.value.size
            good = np.zeros(n, np.bool_)
            good[samples.index] = True
            count["not finite"] = max(count["not finite"], int(np.sum(~good)))
            stale = np.zeros(n, np.bool_)
            stale[samples.index] = stale_flags(samples, step_rad.get(name, 0.0))
            count["stale"] = max(count["stale"], int(stale.sum()))
            good &= ~stale
            for reason, flags in reasons.items():
                if name in rest.joints and at.size:
                    own = flags[at, rest.joints.index(name)]
                    hit = _at_samples(rest.time_s[at], own, log.position.time_s)
                    count[reason] = max(count[reason], int(np.sum(hit & good)))
                    good &= ~hit
            usable[motion.name, name] = good
        refused += [Refusal(motion.name, reason, n) for reason, n in count.items() if n]
    return usable, tuple(refused)


def _at_samples(rest_time_s: Array, flags: Flags, time_s: Array) -> Flags:
    """Return for each position sample whether a neighbour at the low rate is flagged, (n,)."""
    after = np.clip(np.searchsorted(rest_time_s, time_s), 0, flags.size - 1)
    return flags[after] | flags[np.maximum(after - 1, 0)]


FACTORS: Final = {180.0 / math.pi: "degrees", 1000.0: "thousandths"}
"""Factors of units that are mistaken for each other, and the name of the smaller unit."""
CLOSE: Final = 1.5
"""A ratio is near a factor within this factor: a servo follows its command to better than that."""
TURNS: Final = 2.0
"""Usual turns of a joint without limits: those of most such arms go from -360 to 360 degrees."""
FOLLOWS: Final = 0.8
"""Correlation from which two signals count as the same quantity."""


def audit_units(robot: Robot, motions: Sequence[Motion]) -> list[Remark]:
    """Return remarks about units that look wrong."""
    found: list[Remark] = []
    for joint in robot.joints:
        own = [motion for motion in motions if joint.name in motion.joints]
        samples = [joint_samples(motion.joints[joint.name]) for motion in own]
        names = tuple(motion.name for motion in own)
        if joint.mode is ControlMode.POSITION:
            ratio = _ratio((one.command, one.position) for one in samples)
            found += _remark(ratio, joint.name, names, "the position", "its command")
        ratio = _ratio(_velocities(own, samples, joint.name))
        found += _remark(ratio, joint.name, names, "the velocity", "the change of the position")
        found += _beyond_range(robot, joint.name, names, samples)
    return found


def _ratio(pairs: Iterator[tuple[Array, Array]]) -> float:
    """Return the ratio of the second signals to the first; NaN if they do not vary alike.

    It is below 0 if they run against each other in all motions: in a fast one a servo may lag by half a wave.
    """
    ratios: list[float] = []
    for first, second in pairs:
        use = np.isfinite(first) & np.isfinite(second)
        if use.sum() < 3:
            continue
        spread = float(np.std(first[use])), float(np.std(second[use]))
        if min(spread) == 0.0:
            continue
        correlation = float(np.corrcoef(first[use], second[use])[0, 1])
        if abs(correlation) > FOLLOWS:
            ratios.append(math.copysign(spread[1] / spread[0], correlation))
    ratios = [one for one in ratios if one > 0.0] or ratios
    return float(np.median(ratios)) if ratios else math.nan


def _velocities(
    motions: Sequence[Motion], samples: Sequence[Samples], joint: str
) -> Iterator[tuple[Array, Array]]:
    """Yield differences of position and logged velocities, each averaged over a tenth of a second."""
    for motion, one in zip(motions, samples, strict=True):
        velocity = motion.joints[joint].velocity
        if velocity is None or one.time_s.size < 3:
            continue
        width = max(1, round(0.1 / float(np.median(np.diff(one.time_s)))))
        cut = one.time_s.size // width * width
        if cut < 3 * width:
            continue
        mean_v = hold(velocity, one.time_s)[:cut].reshape(-1, width).mean(axis=1)
        mean_t = one.time_s[:cut].reshape(-1, width).mean(axis=1)
        mean_p = one.position[:cut].reshape(-1, width).mean(axis=1)
        yield np.gradient(mean_p, mean_t), mean_v


def _remark(ratio: float, joint: str, motions: tuple[str, ...], what: str, other: str) -> list[Remark]:
    if ratio < 0.0:
        text = f"{what} runs against {other}: is factor = -1 missing at one of them?"
        return [Remark(RemarkKind.UNIT, joint, motions, text, ratio)]
    for factor, unit in FACTORS.items():
        for signed, wrong, right in ((factor, what, other), (1.0 / factor, other, what)):
            if math.isfinite(ratio) and abs(math.log(ratio / signed)) < math.log(CLOSE):
                text = f"{what} is {ratio:.3g} times {other}: is {wrong} in {unit}, or is the unit "
                text += f"of {right} in the robot file wrong?"
                return [Remark(RemarkKind.UNIT, joint, motions, text, ratio)]
    return []


def _beyond_range(
    robot: Robot, joint: str, motions: tuple[str, ...], samples: Sequence[Samples]
) -> list[Remark]:
    """Remark positions far beyond the range of the model that would lie within it in another unit."""
    model, own = robot.model, robot.joint(joint)
    index = int(model.dof_jntid[own.dof_index])
    if not samples:
        return []
    if not model.jnt_limited[index]:
        return [] if own.is_slide else _many_turns(joint, motions, samples)
    allowed = float(np.abs(model.jnt_range[index]).max())
    largest = max(float(np.abs(one.position).max(initial=0.0)) for one in samples)
    for factor, unit in FACTORS.items():
        if allowed * 3.0 < largest <= factor * allowed * CLOSE:
            text = (
                f"the position reaches {own.show(largest)}, the model ends at {own.show(allowed)}: "
                f"is the log in {unit}?"
            )
            return [Remark(RemarkKind.UNIT, joint, motions, text, largest / allowed)]
    return []


def _many_turns(joint: str, motions: tuple[str, ...], samples: Sequence[Samples]) -> list[Remark]:
    """Remark positions of a joint without limits that go over many turns, as degrees would."""
    positions = np.concatenate([one.position for one in samples])
    if np.ptp(positions) <= 2.0 * math.pi * TURNS:
        return []
    low, high = float(positions.min()), float(positions.max())
    text = f"the position goes from {low:.4g} to {high:.4g} rad, over many turns: is the log in degrees?"
    return [Remark(RemarkKind.TURNS, joint, motions, text, high - low, unit="rad")]


START_S: Final = 0.1
"""Time over which the first positions give the velocity at the start: several samples of a slow log."""


@dataclass(frozen=True, slots=True)
class NominalMotion:
    """The nominal model in one motion."""

    motion: str
    position: Mapping[str, Array]
    """Joint -> predicted position at the times of the logged ones, (n,) [rad]; NaN if it blew up."""
    mean_abs_rad: Mapping[str, float]
    """Joint -> mean absolute difference from the logged position."""


class NominalModel:
    """The model of a robot with one motor at each joint, as the robot file describes its controller."""

    def __init__(self, robot: Robot) -> None:
        """Compile the model."""
        self.robot = compile_for(robot, ()).robot
        self.model = self.robot.model
        for joint in self.robot.joints:
            if math.isfinite(joint.torque_limit_Nm):
                limit_Nm = joint.torque_limit_Nm
                self.model.actuator_forcerange[joint.actuator_index] = (-limit_Nm, limit_Nm)

    def simulate(self, motion: Motion) -> NominalMotion:
        """Simulate a motion once, and compare."""
        samples = {one.name: joint_samples(motion.joints[one.name]) for one in self.robot.joints}
        begin_s = min((one.time_s[0] for one in samples.values() if one.time_s.size), default=0.0)
        end_s = max((one.time_s[-1] for one in samples.values() if one.time_s.size), default=0.0)
        period_s = self.robot.control_period_s
        tick_s = begin_s + period_s * np.arange(math.ceil((end_s - begin_s) / period_s) + 1)
        path = self._path(motion, tick_s)
        predicted, error = {}, {}
        for k, (name, one) in enumerate(samples.items()):
            at = motion.joints[name].position.time_s
            predicted[name] = np.interp(at, tick_s, path[:, k])
            difference = np.abs(predicted[name][one.index] - one.position)
            error[name] = float(np.mean(difference)) if difference.size else math.nan
        return NominalMotion(motion.name, predicted, error)

    def _path(self, motion: Motion, tick_s: Array) -> Array:
        """Step through the control periods; return the positions at them, (n, n_joints) [rad].

        They are NaN if a loop has no gain, or if the simulation blew up.
        """
        joints, model, data = self.robot.joints, self.model, mujoco.MjData(self.model)
        if not all(one.knows_gains for one in joints):
            return np.full((tick_s.size, len(joints)), np.nan)
        command = np.stack([_commands(motion.joints[one.name], tick_s) for one in joints], axis=1)
        is_on = np.stack([_enabled(motion.joints[one.name], tick_s) for one in joints], axis=1)
        for one in joints:
            data.qpos[one.qpos_index], data.qvel[one.dof_index] = _start(motion.joints[one.name])
        qpos = [one.qpos_index for one in joints]
        actuators = [one.actuator_index for one in joints]
        path = np.full((tick_s.size, len(joints)), np.nan)
        n_steps = round(self.robot.control_period_s / model.opt.timestep)
        last: Flags = np.zeros(0, np.bool_)
        for tick in range(tick_s.size):
            path[tick] = data.qpos[qpos]
            if not np.array_equal(is_on[tick], last):
                last = is_on[tick]
                self._set_gains(motion, last)
            data.ctrl[actuators] = command[tick]
            mujoco.mj_step(model, data, n_steps)
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                path[:] = np.nan
                break
        return path

    def _set_gains(self, motion: Motion, is_on: Flags) -> None:
        """Write the gains of the controllers; a motor that is off has none."""
        joints = self.robot.joints
        kp, kd = nominal_gains(self.robot)
        gains = np.array([motion.gain.get(one.name, 1.0) for one in joints])
        gain, bias = control_laws(self.robot, (kp * gains)[None], kd[None])
        actuators = [one.actuator_index for one in joints]
        self.model.actuator_gainprm[actuators, 0] = gain[0] * is_on
        self.model.actuator_biasprm[actuators, :3] = bias[0] * is_on[:, None]


def _commands(log: JointLog, tick_s: Array) -> Array:
    """Return the command at each tick, (n,); the last number holds where there is none."""
    if log.command is None:
        return np.zeros(tick_s.size)
    value = hold(log.command, tick_s)
    last = np.maximum.accumulate(np.where(np.isfinite(value), np.arange(value.size), 0))
    return np.nan_to_num(value[last])


def _enabled(log: JointLog, tick_s: Array) -> Flags:
    """Return the ticks at which the motor is on, (n,); without a command it is off."""
    if log.enabled is None or log.command is None:
        return np.full(tick_s.size, log.command is not None)
    return np.asarray(hold(log.enabled, tick_s) > 0.5)


def _start(log: JointLog) -> tuple[float, float]:
    """Return position and velocity at the first sample [rad, rad/s]."""
    one = joint_samples(log)
    if one.time_s.size == 0:
        return 0.0, 0.0
    early = one.time_s <= one.time_s[0] + START_S
    if early.sum() < 2:
        return float(one.position[0]), 0.0
    slope, _ = np.polyfit(one.time_s[early] - one.time_s[0], one.position[early], 1)
    return float(one.position[0]), float(slope)
