"""One batch of simulations: candidates times windows, with effects in each control period."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import mujoco.batch
import numpy as np

from diagnosis.arrays import Array, Flags, Integers
from diagnosis.compiled import Models, UNLIMITED_Nm, laws, nominal_gains
from diagnosis.effects.effect import Effect, Fields, State, Tick
from diagnosis.robot import ControlMode
from diagnosis.sampling import Sampling
from diagnosis.windows import Window

CHUNK: Final = 1024
"""Control periods whose positions are kept until they are sampled: some seconds."""


@dataclass(frozen=True, slots=True)
class ActiveEffect:
    """An effect and its sizes."""

    effect: Effect
    size: Array
    """(n_candidates, n_sizes)."""


@dataclass(slots=True)
class _Acting:
    """An effect in a batch."""

    effect: Effect
    size: Array
    """(n_sims, n_sizes)."""
    joint: int
    """-1 if its place is no joint."""
    memory: dict[str, Array]


class Simulation:
    """A batch. Simulation s is candidate s % n_candidates in window s // n_candidates, the longest first."""

    def __init__(
        self,
        models: Models,
        effects: Sequence[ActiveEffect],
        windows: Sequence[Window],
        n_candidates: int,
        n_threads: int,
    ) -> None:
        """Set models, commands and starts.

        Args:
            models: Models of the robot.
            effects: Effects with their sizes for each candidate.
            windows: Windows.
            n_candidates: Number of candidates.
            n_threads: Threads; 0: as many as there are processors.
        """
        self._compiled = models.compiled([one.effect for one in effects])
        self._robot = self._compiled.robot
        self._order = sorted(range(len(windows)), key=lambda w: -windows[w].n_ticks)
        self._windows = [windows[w] for w in self._order]
        self._n_candidates, self._n_joints = n_candidates, len(self._robot.joints)
        self._n_sims = n_candidates * len(windows)
        self._batch = mujoco.batch.Batch(self._robot.model, self._n_sims, nthread=n_threads)
        names = [joint.name for joint in self._robot.joints]
        self._acting = [
            _Acting(
                one.effect,
                np.tile(one.size, (len(windows), 1)),
                names.index(one.effect.place) if one.effect.place in names else -1,
                {},
            )
            for one in effects
        ]
        self._fields = self._set_model()
        self._command = self._commands()
        self._set_start()
        self._bind()

    def _with(self, hook: str) -> list[_Acting]:
        return [one for one in self._acting if one.effect.overrides(hook)]

    def _at(self, hook: str, joint: int) -> list[_Acting]:
        return [one for one in self._with(hook) if one.joint == joint]

    def _sims(self, w: int) -> slice:
        """Return the simulations of a window."""
        return slice(w * self._n_candidates, (w + 1) * self._n_candidates)

    def _set_model(self) -> Fields:
        """Set the numbers of the model and of the actuators."""
        model, dof, batch = self._robot.model, self._compiled.dof, self._batch
        kp, kd = nominal_gains(self._robot)
        gain = np.repeat([window.gain for window in self._windows], self._n_candidates, axis=0)

        def rows(values: Array) -> Array:
            return np.tile(values, (self._n_sims, 1))

        fields = Fields(
            kp_Nm_rad=kp * gain,
            kd_Nms_rad=rows(kd),
            torque_limit_Nm=rows(np.array([joint.torque_limit_Nm for joint in self._robot.joints])),
            damping_Nms_rad=rows(model.dof_damping[dof]),
            frictionloss_Nm=rows(model.dof_frictionloss[dof]),
            armature_kgm2=rows(model.dof_armature[dof]),
            batch=batch,
        )
        for one in self._with("set_model"):
            one.effect.set_model(one.size, fields, self._robot)
        fields.frictionloss_Nm = np.maximum(fields.frictionloss_Nm, 0.0)
        fields.armature_kgm2 = np.maximum(fields.armature_kgm2, 0.0)
        batch.expand("dof_damping")[:, dof] = np.maximum(fields.damping_Nms_rad, 0.0)
        batch.expand("dof_armature")[:, dof] = fields.armature_kgm2
        self._friction = batch.expand("dof_frictionloss")
        self._friction[:, dof] = fields.frictionloss_Nm
        self._limits = batch.expand("actuator_forcerange")
        self._gainprm, self._biasprm = batch.expand("actuator_gainprm"), batch.expand("actuator_biasprm")
        self._write_limit(fields.torque_limit_Nm)
        self._write_gain(fields.kp_Nm_rad, fields.kd_Nms_rad)
        batch.set_const()
        return fields

    def _write_limit(self, limit_Nm: Array) -> None:
        n, motor = limit_Nm.shape[0], self._compiled.actuator
        high = np.clip(limit_Nm, 0.0, UNLIMITED_Nm)
        self._limits[:n, motor, 0] = -high
        self._limits[:n, motor, 1] = high

    def _write_gain(self, kp: Array, kd: Array) -> None:
        n, motor = kp.shape[0], self._compiled.actuator
        self._gainprm[:n, motor, 0], self._biasprm[:n, motor, :3] = laws(self._robot, kp, kd)

    def _commands(self) -> Array:
        """Compute the commands as they arrive, (n_ticks, n_sims, n_joints)."""
        period_s = self._robot.control_period_s
        command = np.zeros((self._windows[0].n_ticks, self._n_sims, self._n_joints))
        for j, joint in enumerate(self._robot.joints):
            shape, decode = self._at("shape_command", j), self._at("decode", j)
            for w, window in enumerate(self._windows):
                sims = self._sims(w)
                arrived: Array = window.command[None, :, j]
                if shape or decode:
                    arrived = np.tile(arrived, (self._n_candidates, 1))
                for one in shape:
                    arrived = one.effect.shape_command(one.size[sims], arrived, period_s)
                if joint.mode is ControlMode.POSITION:
                    for one in reversed(decode):
                        arrived = one.effect.decode(one.size[sims], arrived)
                command[: window.n_ticks, sims, j] = arrived[:, window.n_lead :].T
        return command

    def _set_start(self) -> None:
        """Set the measured starts, and compute the forces there."""
        q = np.repeat([window.q_rad for window in self._windows], self._n_candidates, axis=0)
        for one in reversed(self._with("decode")):
            q[:, one.joint] = one.effect.decode(one.size, q[:, [one.joint]])[:, 0]
        v = np.repeat([window.v_rad_s for window in self._windows], self._n_candidates, axis=0)
        self._batch.bind("qpos")[:, self._compiled.qpos] = q
        self._batch.bind("qvel")[:, self._compiled.dof] = v
        self._batch.bind("ctrl")[:, self._compiled.actuator] = self._command[0]

    def _bind(self) -> None:
        """Bind what is read and written in each control period."""
        batch = self._batch
        self._qpos, self._qvel, self._ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self._applied = batch.bind("qfrc_applied")
        self._acts, self._frictions = self._with("act"), self._with("friction_Nm")
        self._torques = self._with("torque_Nm")
        self._has_effects = bool(self._acts or self._frictions or self._torques)
        if self._has_effects:
            names = ("qfrc_bias", "qfrc_smooth", "qfrc_constraint", "qacc", "actuator_force")
            self._forces = [batch.bind(name) for name in names]
        heat = [window.temperature_degC for window in self._windows]
        self._temperature = np.repeat(heat, self._n_candidates, axis=0)
        self._is_switched = not all(window.enabled.all() for window in self._windows)
        self._factor = np.ones((self._n_sims, self._n_joints))
        self._n_steps = round(self._robot.control_period_s / self._robot.model.opt.timestep)
        self._n = -1
        self._ids: Integers = np.zeros(0, dtype=np.int64)

    def positions(self) -> Array:
        """Simulate and sample.

        Returns:
            What the encoders show, (n_candidates, n_samples) [rad]; NaN where a simulation failed.
        """
        sampling = self._sampling()
        failed = np.zeros(self._n_sims, dtype=bool)
        self._call(failed, self._batch.forward)
        n_ticks = self._windows[0].n_ticks
        path = np.empty((CHUNK + 1, self._n_sims, self._n_joints))
        for first in range(0, n_ticks, CHUNK):
            last = min(first + CHUNK, n_ticks)
            path[0] = self._qpos[:, self._compiled.qpos]
            for k in range(first, last):
                self._cut(k, failed)
                self._tick(k)
                self._call(failed, self._step)
                path[k + 1 - first] = self._qpos[:, self._compiled.qpos]
            sampling.take(path, first, last)
        return self._encoded(sampling.values, failed)

    def _sampling(self) -> Sampling:
        """Prepare the samples, with their delays."""
        late_s = np.zeros((len(self._windows), self._n_candidates, self._n_joints))
        for one in self._with("sample_delay_s"):
            delay_s = one.effect.sample_delay_s(one.size)
            late_s[:, :, one.joint] += delay_s.reshape(len(self._windows), self._n_candidates)
        return Sampling(self._windows, self._order, late_s, self._robot.control_period_s)

    def _encoded(self, q_rad: Array, failed: Flags) -> Array:
        """Return what the encoders show at sampled positions, (n_candidates, n_samples)."""
        first = 0
        place = {w: k for k, w in enumerate(self._order)}
        for w in range(len(self._windows)):
            sims = self._sims(place[w])
            for j, time_s in enumerate(self._windows[place[w]].sample_time_s):
                part = slice(first, first + time_s.size)
                for one in self._at("encode", j):
                    q_rad[:, part] = one.effect.encode(one.size[sims], q_rad[:, part])
                q_rad[failed[sims], part] = np.nan
                first += time_s.size
        return q_rad

    def _call(self, failed: Flags, job: Callable[[], None]) -> None:
        """Call MuJoCo, and mark the simulations that it cannot continue."""
        try:
            job()
        except mujoco.batch.SimulationError as error:
            failed[error.ids] = True
        if self._batch.warning.any():
            failed |= self._batch.warning.reshape(self._n_sims, -1).any(axis=1)
            self._batch.warning[:] = 0

    def _cut(self, k: int, failed: Flags) -> None:
        """Keep the simulations whose window goes on, which are the first ones; leave out the failed ones."""
        n = self._n_candidates * sum(window.n_ticks > k for window in self._windows)
        if n != self._n:
            self._n = n
            self._factor = self._factor[:n]
            for one in self._acting:
                one.size = one.size[:n]
                one.memory = {name: kept[:n] for name, kept in one.memory.items()}
        elif self._ids.size + np.count_nonzero(failed[:n]) == n:
            return
        self._ids = np.flatnonzero(~failed[:n])

    def _step(self) -> None:
        """Step through a control period."""
        self._batch.step(self._ids, nstep=self._n_steps)

    def _tick(self, k: int) -> None:
        """Set the inputs of a control period."""
        n, dof, motor = self._n, self._compiled.dof, self._compiled.actuator
        if not self._has_effects:
            self._ctrl[:n, motor] = self._command[k, :n]
            if self._is_switched:
                self._scale_gain(self._enabled(k))
            return
        fields = self._fields
        bias, smooth, constraint, qacc = (force[:n, dof] for force in self._forces[:4])
        state = State(
            time_s=np.full(n, k * self._robot.control_period_s),
            q_rad=self._qpos[:n, self._compiled.qpos],
            v_rad_s=self._qvel[:n, dof],
            load_Nm=bias + smooth + constraint - fields.armature_kgm2[:n] * qacc,
            temperature_degC=self._temperature[:n],
        )
        tick = Tick(
            state=state,
            command=self._command[k, :n],
            applied_Nm=np.zeros((n, self._n_joints)),
            frictionloss_Nm=fields.frictionloss_Nm[:n].copy(),
            torque_limit_Nm=fields.torque_limit_Nm[:n].copy(),
            gain=np.ones((n, self._n_joints)),
            motor_Nm=self._forces[4][:n, motor],
            period_s=self._robot.control_period_s,
            memory={},
        )
        for one in self._acts:
            tick.memory = one.memory
            one.effect.act(one.size, tick)
        for one in self._frictions:
            tick.frictionloss_Nm[:, one.joint] += one.effect.friction_Nm(one.size, state)
        for one in self._torques:
            tick.applied_Nm[:, one.joint] += one.effect.torque_Nm(one.size, state)
        self._write(k, tick)

    def _write(self, k: int, tick: Tick) -> None:
        """Write what effects may have changed."""
        n, dof = self._n, self._compiled.dof
        self._ctrl[:n, self._compiled.actuator] = tick.command
        if self._acts or self._torques:
            self._applied[:n, dof] = tick.applied_Nm
        if self._acts or self._frictions:
            self._friction[:n, dof] = tick.frictionloss_Nm
        if self._acts:
            self._write_limit(tick.torque_limit_Nm)
        if self._acts or self._is_switched:
            self._scale_gain(tick.gain * self._enabled(k) if self._is_switched else tick.gain)

    def _enabled(self, k: int) -> Array:
        """Return 1 where a motor has torque in a control period, else 0, (n, n_joints)."""
        alive = self._windows[: self._n // self._n_candidates]
        return np.repeat([window.enabled[k] for window in alive], self._n_candidates, axis=0).astype(float)

    def _scale_gain(self, factor: Array) -> None:
        if not np.array_equal(factor, self._factor):
            self._factor = factor
            fields = self._fields
            self._write_gain(fields.kp_Nm_rad[: self._n] * factor, fields.kd_Nms_rad[: self._n] * factor)
