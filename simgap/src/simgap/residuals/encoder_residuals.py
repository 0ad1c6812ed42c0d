"""Residuals of a second encoder: how it varies against the encoder of the motor.

    residual = (second - motor) - (predicted difference), less its mean over the log

The mean is left out, because the zero of one encoder against the other is not calibrated. For an effect at
a joint, the hooks speak of the second encoder: it shows encode(q + deflection) at the time t - sample delay,
where q is the angle of the motor.

The load that twists a gear is the measured torque, where one is logged, less inertia of the rotor and
friction. A load from the model alone would lack what the model lacks: behind a counterbalance, the gear
carries less than gravity says. The friction is fitted, for each joint and motion, by least squares on
measured torque minus inverse dynamics, with the columns sign(v), v, cos q and sin q. The waves keep a torque
that depends on position out of the friction; only the first two are subtracted. No other motion takes part,
so that the load of held-out motions is as measured as their angles.
"""

from collections.abc import Sequence
from copy import copy

import numpy as np
from scipy.interpolate import CubicSpline

from simgap.arrays import Array, Integers
from simgap.common.errors import RobotError
from simgap.effects.effect import ENCODER_HOOKS, Effect, State
from simgap.logs import Motion, Usable
from simgap.residuals.filtered_motion import (
    FilteredMotion,
    LowPass,
    choose_filter,
    filter_motion,
    find_usable,
    inverse_dynamics,
)
from simgap.residuals.residuals import SECOND_ENCODER, measured_variable
from simgap.robot import Robot


def shows(effect: Effect) -> bool:
    """Return whether the difference of two encoders can show an effect."""
    return effect.overrides(*ENCODER_HOOKS) and len(effect.parts) == 1


def why_refused(robot: Robot, effect: Effect) -> str:
    """Say why an effect has no name, whatever the fit says; empty if it may be named.

    Without gravity the load of a gear is inertia times acceleration. Two encoders whose filters differ in the
    second order differ in proportion to the acceleration too, so the two are one.
    """
    names = {joint.name for joint in robot.joints}
    if not effect.overrides("deflection_rad") or effect.place not in names:
        return ""
    if robot.joint(effect.place).is_loaded_by_gravity:
        return ""
    return (
        f"{effect.place}: gravity does not load it; a deflection by acceleration alone "
        "cannot be told from different filters of the two encoders"
    )


class EncoderResiduals:
    """Predict the difference of two encoders; see `ResidualModel`."""

    kind = SECOND_ENCODER
    by_motion = False
    step_s = 0.0
    noise_std = 0.0

    def __init__(self, robot: Robot, motions: Sequence[Motion], keep: Usable | None = None) -> None:
        """Compare the encoders, and compute the loads; RobotError if no second encoder can be used."""
        self._robot, self._keep = robot, keep or {}
        self.joints = tuple(joint.name for joint in robot.joints)
        self.units = tuple(joint.unit for joint in robot.joints)
        self.low_pass = choose_filter(robot, motions)
        self.method = (
            "The second encoder is compared with the first; loads come from positions that pass "
            f"{self.low_pass.describe()}."
        )
        filtered = [filter_motion(robot, motion, self.low_pass) for motion in motions]
        if not any(_has_second(motion, name) for motion in motions for name in self.joints):
            raise RobotError(f"robot {robot.name}: no log has a second encoder that moves")
        states = [
            State(
                one.time_s, one.q_rad, one.v_rad_s, _load_Nm(robot, one, self.low_pass), one.temperature_degC
            )
            for one in filtered
        ]
        self._fill(motions, states)

    def _fill(self, logs: Sequence[Motion], states: Sequence[State]) -> None:
        self._logs, self._states = tuple(logs), tuple(states)
        self.motions = tuple(motion.name for motion in logs)
        self.repeat_of = tuple(motion.repeat_of for motion in logs)
        self._parts: list[_Part] = []
        for m, motion in enumerate(logs):
            for j, name in enumerate(self.joints):
                part = _Part(motion, name, m, j, self._keep) if _has_second(motion, name) else None
                if part is not None and part.time_s.size:
                    self._parts.append(part)
        if not self._parts:
            raise RobotError(f"robot {self._robot.name}: no sample of a second encoder can be used")
        self.joint_of: Integers = np.concatenate([np.full(one.time_s.size, one.joint) for one in self._parts])
        self.motion_of: Integers = np.concatenate(
            [np.full(one.time_s.size, one.motion) for one in self._parts]
        )
        self.time_s: Array = np.concatenate([one.time_s for one in self._parts])

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return measured minus predicted differences without their means, (n_candidates, n) [rad].

        Effects that `shows` refuses change nothing.
        """
        sizes = np.asarray(sizes, float)
        starts = np.cumsum([0, *(len(effect.sizes) for effect in effects)])
        at: dict[str, list[tuple[Effect, Array]]] = {}
        for k, effect in enumerate(effects):
            size = sizes[:, starts[k] : starts[k + 1]]
            if shows(effect) and size.any():
                at.setdefault(effect.place, []).append((effect, size))
        return np.concatenate(
            [
                part.residuals(at.get(self.joints[part.joint], []), self._states[part.motion], len(sizes))
                for part in self._parts
            ],
            axis=1,
        )

    def select(self, motions: Sequence[str]) -> "EncoderResiduals":
        """Return the residuals of these motions alone, in their old order, with the same loads."""
        kept = [k for k, motion in enumerate(self._logs) if motion.name in set(motions)]
        chosen = copy(self)
        chosen._fill([self._logs[k] for k in kept], [self._states[k] for k in kept])
        return chosen

    def explain(self, name: str) -> Array:
        """Return a variable at the filtered motion of the motor, (n,); NaN where it is not logged."""
        if name not in ("position", "velocity", "load"):
            return measured_variable(
                self._robot, self._logs, name, self.motion_of, self.joint_of, self.time_s
            )
        found = []
        for part in self._parts:
            state = self._states[part.motion]
            value = {"position": state.q_rad, "velocity": state.v_rad_s, "load": state.load_Nm}[name]
            found.append(np.interp(part.time_s, state.time_s, value[:, part.joint]))
        return np.concatenate(found)


class _Part:
    """The two encoders of one joint in one motion."""

    def __init__(self, motion: Motion, name: str, m: int, j: int, keep: Usable) -> None:
        log = motion.joints[name]
        assert log.secondary is not None
        position = log.position
        inside = (log.secondary.time_s >= position.time_s[0]) & (log.secondary.time_s <= position.time_s[-1])
        # the spline between two samples needs both
        period_s = float(np.median(np.diff(position.time_s)))
        inside &= find_usable(log, keep.get((motion.name, name)), log.secondary.time_s, period_s)
        self.motion, self.joint = m, j
        self.time_s = log.secondary.time_s[inside]
        self._second_rad = log.secondary.value[inside]
        self._motor = CubicSpline(position.time_s, position.value)
        self._span_s = (float(position.time_s[0]), float(position.time_s[-1]))

    def residuals(self, acting: Sequence[tuple[Effect, Array]], state: State, n: int) -> Array:
        """Return the residuals, (n, n_times), under the effects of this joint with their sizes."""
        late_s = np.zeros(n)
        for effect, size in acting:
            if effect.overrides("sample_delay_s"):
                late_s = late_s + effect.sample_delay_s(size)
        found = np.empty((n, self.time_s.size))
        for late in np.unique(late_s):
            rows = np.flatnonzero(late_s == late)
            then_s = np.clip(self.time_s - late, *self._span_s)
            found[rows] = self._motor(then_s)
            for effect, size in acting:
                if effect.overrides("deflection_rad"):
                    for row in rows[size[rows].any(axis=1)]:
                        each = np.broadcast_to(size[row], (state.time_s.size, size.shape[1]))
                        bent_rad = effect.deflection_rad(each, state)
                        found[row] += np.interp(then_s, state.time_s, bent_rad)
        for effect, size in acting:
            if effect.overrides("encode"):
                found = effect.encode(size, found)
        residual = self._second_rad - found
        return np.asarray(residual - residual.mean(axis=1, keepdims=True))


def _has_second(motion: Motion, joint: str) -> bool:
    log = motion.joints.get(joint)
    return log is not None and log.secondary is not None and bool(np.ptp(log.secondary.value) > 0)


def _load_Nm(robot: Robot, one: FilteredMotion, low_pass: LowPass) -> Array:
    """Return the loads of all gears in a motion, (n, n_joints) [N m]."""
    needed, load = inverse_dynamics(copy(robot.model), robot, one.q_rad, one.v_rad_s, one.a_rad_s2)
    load = load.copy()
    for j, joint in enumerate(robot.joints):
        if not np.isfinite(one.torque_Nm[0, j]):
            continue
        speed, q = one.v_rad_s[:, j], one.q_rad[:, j]
        at_gear = one.torque_Nm[:, j] - robot.model.dof_armature[joint.dof_index] * one.a_rad_s2[:, j]
        sign = low_pass(np.tanh(speed / low_pass.friction_speed_rad_s[j]))
        columns = np.stack([sign, speed, np.cos(q), np.sin(q)], axis=1)
        size = np.linalg.lstsq(columns, at_gear - needed[:, j])[0]
        load[:, j] = at_gear - columns[:, :2] @ size[:2]
    return load
