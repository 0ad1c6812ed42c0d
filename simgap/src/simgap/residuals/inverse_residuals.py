"""Residuals of inverse dynamics: measured joint torques minus those that the measured motion needs.

    residual = measured - (inverse dynamics + armature a + damping v + friction sign(v) - applied torques) / k

k is 1, or the true over the given torque constant, where a current is measured and its constant is not known:
the noise of the current is then no error of a regressor.

Motion and measured torque pass one filter (`filtered_motion`), and so does the dry friction: its step
at a reversal is as steep as that of the measured torque. The sign of the speed is smoothed over the
speed at which it is certain: tanh(v / v_s), with v_s three times the noise of the speed. The first and last
period of the cut-off are left out, because there the filter guesses what was before and after. So is a
joint until it has moved by `MEMORY_rad`: until then its dry friction remembers what was before the log.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Final

import mujoco.batch
import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.common.errors import RobotError
from simgap.effects.effect import TORQUE_HOOKS, Effect, State
from simgap.logs import Motion, Usable
from simgap.residuals.filtered_motion import (
    FilteredMotion,
    choose_filter,
    differentiate,
    filter_motion,
    find_usable,
    inverse_dynamics,
)
from simgap.residuals.residuals import measured_variable, split_sizes
from simgap.robot import Robot
from simgap.simulation.compiled import nominal_fields

PER_CUT_OFF: Final = 4.0
"""Residuals in a period of the cut-off frequency: twice as many as a signal without higher ones needs."""
MEMORY_rad: Final = 3e-3
"""Motion after which dry friction has forgotten where it stood at the start of a log.

Dry friction is a spring until it slides (Dahl 1968), and some milliradians of a geared joint are that spring.
Fitted to one batch of the KR300 with base parameters and a position-dependent torque, axis 2 has on the
other batch, as RMS of the motor's torque, A to B and B to A [N m]: nothing left out 1.90, 3.39; 0.3 mrad
1.34, 2.18; 1 mrad 1.11, 1.54; 3 mrad 0.95, 1.13; 10 mrad 0.82, 0.92. Axes 3 and 5 gain less beyond 3 mrad."""


@dataclass(frozen=True, slots=True)
class _ActingTorque:
    effect: Effect
    size: Array
    """(n_candidates, n_sizes)."""
    joint: int
    """-1 if its place is no joint."""


def shows(effect: Effect) -> bool:
    """Return whether torques at the measured motion can show an effect.

    Effects that add bodies or joints to the model are left out: their motion is not measured.
    """
    return not effect.overrides("vary") and effect.overrides(*TORQUE_HOOKS)


class InverseResiduals:
    """Predict measured minus needed torques; see `ResidualModel`."""

    kind = "inverse dynamics"
    by_motion = True
    step_s = 0.0
    noise_std = 0.0

    def __init__(self, robot: Robot, motions: Sequence[Motion], keep: Usable | None = None) -> None:
        """Filter the motions; RobotError if no torque is usable, or a motion is too short for a filter.

        Nothing is compared within a period of the cut-off from samples that take no part.
        """
        if not any(log.torque is not None for motion in motions for log in motion.joints.values()):
            raise RobotError(f"robot {robot.name}: no log has torques; inverse dynamics needs them")
        self._robot = robot
        self.low_pass = choose_filter(robot, motions)
        samples = 1 / (self.low_pass.cut_off_Hz * self.low_pass.period_s)  # in a period of the cut-off
        self._keep = keep or {}
        self._kept = slice(int(samples), -int(samples), max(1, int(samples / PER_CUT_OFF)))
        spacing_s = self._kept.step * self.low_pass.period_s
        self.method = (
            f"Torques are compared with inverse dynamics; both pass {self.low_pass.describe()}. There is a "
            f"residual every {1e3 * spacing_s:.3g} ms. A joint has none before it has moved by "
            f"{1e3 * MEMORY_rad:g} mrad, as its dry friction remembers what was before the log."
        )
        self._fill(motions, [filter_motion(robot, motion, self.low_pass) for motion in motions])

    def _fill(self, logs: Sequence[Motion], filtered: Sequence[FilteredMotion]) -> None:
        self._logs, self._filtered = tuple(logs), tuple(filtered)
        self._kept_of = [_thin(one, self._kept) for one in filtered]
        self._nominal: dict[tuple[int, int], tuple[Array, Array]] = {}
        self._signs: dict[int, Array] = {}
        self.joints = tuple(joint.name for joint in self._robot.joints)
        self.units = tuple(joint.effort_unit for joint in self._robot.joints)
        self.motions = tuple(motion.name for motion in logs)
        self.repeat_of = tuple(motion.repeat_of for motion in logs)
        self._usable: dict[str, Flags] = {}
        joint_of, motion_of, time_s = [], [], []
        for m, (log, one) in enumerate(zip(logs, filtered, strict=True)):
            every = one.time_s[self._kept]
            usable = [self._find_usable(log, one, j, every) for j in self._logged(one)]
            self._usable[one.name] = np.concatenate([np.zeros(0, bool), *usable])
            for j, flags in zip(self._logged(one), usable, strict=True):
                times = every[flags]
                joint_of.append(np.full(times.size, j))
                motion_of.append(np.full(times.size, m))
                time_s.append(times)
        if not any(times.size for times in time_s):
            raise RobotError(f"robot {self._robot.name}: no sample of a torque can be used; correct the logs")
        self.joint_of: Integers = np.concatenate(joint_of)
        self.motion_of: Integers = np.concatenate(motion_of)
        self.time_s: Array = np.concatenate(time_s)

    def _find_usable(self, motion: Motion, one: FilteredMotion, j: int, time_s: Array) -> Flags:
        name = self.joints[j]
        keep = self._keep.get((motion.name, name))
        margin_s = 1.0 / self.low_pass.cut_off_Hz
        slides = time_s >= self._slides_from_s(one, j)
        return slides & find_usable(motion.joints[name], keep, time_s, margin_s)

    def _slides_from_s(self, one: FilteredMotion, j: int) -> float:
        """Return the time from which the dry friction of a joint is that of this motion [s].

        A joint that never moves as far has one unknown friction in the whole motion, and all of it counts.
        """
        moved = np.abs(one.q_rad[:, j] - one.q_rad[0, j]) > MEMORY_rad * self._robot.joints[j].per_rad
        return float(one.time_s[np.argmax(moved)]) if moved.any() else -np.inf

    @staticmethod
    def _logged(one: FilteredMotion) -> Integers:
        return np.flatnonzero(np.isfinite(one.torque_Nm[0]))

    def _rows(self, one: FilteredMotion, values: Array) -> Array:
        """Order values, (..., n_kept, n_joints), as residuals, (..., n)."""
        logged = np.moveaxis(values[..., self._logged(one)], -1, -2)
        return logged.reshape(*logged.shape[:-2], -1)[..., self._usable[one.name]]

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return measured minus needed torques, (n_candidates, n) [N m].

        Effects that `shows` refuses change nothing.
        """
        sizes = np.asarray(sizes, float)
        if sizes.ndim == 2:
            sizes = np.repeat(sizes[:, None], len(self.motions), axis=1)
        every = sizes.reshape(sizes.shape[0] * sizes.shape[1], sizes.shape[2])
        distinct, which = np.unique(every, axis=0, return_inverse=True)
        candidates = _Candidates(self._robot, self._acting(effects, distinct), len(distinct))
        found = np.empty((len(sizes), self.motion_of.size))
        of_motion = [np.flatnonzero(self.motion_of == m) for m in range(len(self.motions))]
        for c in range(len(distinct)):  # all motions of a candidate in turn, for which its model is made once
            wanted = which.reshape(sizes.shape[:2]) == c
            for m in np.flatnonzero(wanted.any(axis=0)).tolist():
                found[np.ix_(wanted[:, m], of_motion[m])] = self._of_candidate(m, candidates, c)
        return found

    def _acting(self, effects: Sequence[Effect], sizes: Array) -> list[_ActingTorque]:
        found = []
        for effect, size in split_sizes(effects, sizes):
            if shows(effect) and size.any():
                joint = self.joints.index(effect.place) if effect.place in self.joints else -1
                found.append(_ActingTorque(effect, size, joint))
        return found

    def _of_candidate(self, m: int, candidates: "_Candidates", c: int) -> Array:
        one = self._decoded(m, candidates, c)
        kept = self._kept_of[m] if one is self._filtered[m] else _thin(one, self._kept)
        torque_Nm = self._needed_Nm(m, candidates, c, kept) + self._dry_Nm(m, candidates, c, one)
        return self._rows(kept, kept.torque_Nm - torque_Nm / candidates.fields.torque_scale[c])

    def _dynamics(self, m: int, model: mujoco.MjModel | None, one: FilteredMotion) -> tuple[Array, Array]:
        """Return torque and load of a motion, or of its kept samples; those of the nominal model once."""
        is_measured = one is self._filtered[m] or one is self._kept_of[m]
        if model is None and is_measured and (m, one.time_s.size) in self._nominal:
            return self._nominal[m, one.time_s.size]
        chosen = copy(self._robot.model) if model is None else model
        found = inverse_dynamics(chosen, self._robot, one.q_rad, one.v_rad_s, one.a_rad_s2)
        if model is None and is_measured:
            self._nominal[m, one.time_s.size] = found
        return found

    def _decoded(self, m: int, candidates: "_Candidates", c: int) -> FilteredMotion:
        """Return the motion that the encoders of a candidate have shown as the measured one."""
        one = self._filtered[m]
        decoders = [e for e in candidates.with_hook("decode") if e.size[c].any()]
        if not decoders:
            return one
        raw = one.raw_rad.copy()
        for e in reversed(decoders):
            raw[:, e.joint] = e.effect.decode(e.size[c : c + 1], raw[None, :, e.joint])[0]
        q, v, a = differentiate(raw, self.low_pass)
        return FilteredMotion(one.name, one.time_s, raw, q, v, a, one.torque_Nm, one.temperature_degC)

    def _needed_Nm(self, m: int, candidates: "_Candidates", c: int, kept: FilteredMotion) -> Array:
        """Return the torque that a candidate needs beside dry friction, (n_kept, n_joints)."""
        torque, load = self._dynamics(m, candidates.model(c), kept)
        fields = candidates.fields
        total = torque + fields.armature_kgm2[c] * kept.a_rad_s2 + fields.damping_Nms_rad[c] * kept.v_rad_s
        for e in candidates.with_hook("torque_Nm"):
            if e.size[c].any():
                total[:, e.joint] -= e.effect.torque_Nm(_each(e.size[c], kept), _state(kept, load))
        return np.asarray(total)

    def _dry_Nm(self, m: int, candidates: "_Candidates", c: int, one: FilteredMotion) -> Array:
        """Return the dry friction of a candidate as the filter shows it, (n_kept, n_joints).

        Where the friction is constant, the filter has seen the sign of the speed once for all candidates.
        """
        constant_Nm = candidates.fields.frictionloss_Nm[c]
        if one is self._filtered[m]:
            if m not in self._signs:
                self._signs[m] = self.low_pass(self._sign(one))[self._kept]
            filtered = self._signs[m]
        else:
            filtered = self.low_pass(self._sign(one))[self._kept]
        found = np.maximum(constant_Nm, 0.0) * filtered
        varying = [e for e in candidates.with_hook("friction_Nm") if e.size[c].any()]
        if varying:
            state = _state(one, self._dynamics(m, candidates.model(c), one)[1])
        for j in dict.fromkeys(e.joint for e in varying):
            own = [e.effect.friction_Nm(_each(e.size[c], one), state) for e in varying if e.joint == j]
            dry_Nm = np.maximum(constant_Nm[j] + np.sum(own, axis=0), 0.0)
            found[:, j] = self.low_pass(dry_Nm * self._sign(one)[:, j])[self._kept]
        return np.asarray(found)

    def _sign(self, one: FilteredMotion) -> Array:
        return np.asarray(np.tanh(one.v_rad_s / self.low_pass.friction_speed_rad_s))

    def select(self, motions: Sequence[str]) -> "InverseResiduals":
        """Return the residuals of these motions alone, in their old order, with the same filter."""
        kept = [k for k, motion in enumerate(self._logs) if motion.name in set(motions)]
        chosen = copy(self)
        chosen._fill([self._logs[k] for k in kept], [self._filtered[k] for k in kept])
        return chosen

    def explain(self, name: str) -> Array:
        """Return a variable at the filtered motion, (n,); NaN where it is not logged."""
        if name not in ("position", "velocity", "load"):
            return measured_variable(
                self._robot, self._logs, name, self.motion_of, self.joint_of, self.time_s
            )
        values = []
        for m, one in enumerate(self._kept_of):
            variable = {"position": one.q_rad, "velocity": one.v_rad_s}.get(name)
            values.append(self._rows(one, self._dynamics(m, None, one)[1] if variable is None else variable))
        return np.concatenate(values)


def _thin(one: FilteredMotion, kept: slice) -> FilteredMotion:
    """Return the samples at which there are residuals."""
    arrays = (getattr(one, part.name)[kept] for part in fields(one) if part.name != "name")
    return FilteredMotion(one.name, *arrays)


def _state(one: FilteredMotion, load_Nm: Array) -> State:
    return State(one.time_s, one.q_rad, one.v_rad_s, load_Nm, one.temperature_degC)


def _each(size: Array, one: FilteredMotion) -> Array:
    """Repeat the sizes of a candidate for all samples: hooks take a row for each."""
    return np.broadcast_to(size, (one.time_s.size, size.size))


class _Candidates:
    """Numbers of the model for each candidate."""

    def __init__(self, robot: Robot, acting: Sequence[_ActingTorque], n: int) -> None:
        self._batch = mujoco.batch.Batch(robot.model, nsim=n, nthread=1)
        self._with_hook = {
            hook: [one for one in acting if one.effect.overrides(hook)] for hook in TORQUE_HOOKS
        }
        self._models: dict[int, mujoco.MjModel] = {}
        self.fields = nominal_fields(robot, n, self._batch)
        for one in self.with_hook("set_model"):
            one.effect.set_model(one.size, self.fields, robot)
        names = [name for name in mujoco.batch.MODEL_FIELDS if self._batch.expanded(name) is not None]
        changed = np.zeros(n, dtype=bool)
        for name in names:
            nominal = np.asarray(attrgetter(name)(robot.model)).reshape(1, -1)
            changed |= np.any(self._batch.expanded(name).reshape(n, -1) != nominal, axis=1)
        self._changed = changed
        if changed.any():
            self._batch.set_const()

    def with_hook(self, hook: str) -> list[_ActingTorque]:
        """Return the effects that override a hook."""
        return self._with_hook[hook]

    def model(self, c: int) -> mujoco.MjModel | None:
        """Return the model of a candidate; None if its fields are nominal."""
        if self._changed[c] and c not in self._models:
            self._models = {c: self._batch.get_model(c)}
        return self._models[c] if self._changed[c] else None
