"""Forward simulation of many candidates in many windows at once, with effects that act in each control period."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import mujoco.batch
import numpy as np

from diagnosis.arrays import Array, Flags, Integers
from diagnosis.compiled import UNLIMITED_Nm, Compiled, compile_for, laws, nominal_gains
from diagnosis.effects.effect import Effect, Fields, State, Tick
from diagnosis.robot import ControlMode, Robot
from diagnosis.windows import Window

MEMORY_BYTES: Final = 256_000_000
"""Commands and positions that are kept at once."""


class Engine:
    """Simulations of a robot with a set of effects in a set of windows."""

    def __init__(
        self, robot: Robot, effects: Sequence[Effect], windows: Sequence[Window], n_threads: int = 0
    ) -> None:
        """Compile the model.

        Args:
            robot: Robot.
            effects: Effects of all candidates.
            windows: Windows to simulate.
            n_threads: Threads; 0: as many as there are processors. The result does not depend on it.
        """
        self.compiled = compile_for(robot, effects)
        self.effects = tuple(effects)
        self.windows = tuple(windows)
        self.n_threads = n_threads
        counts = [one.size for window in windows for one in window.sample_time_s]
        self._ends = np.cumsum([0, *counts])
        self._longest_first = sorted(range(len(windows)), key=lambda w: -windows[w].n_ticks)

    @property
    def n_samples(self) -> int:
        """Number of positions of one candidate."""
        return int(self._ends[-1])

    def positions(self, sizes: Array) -> Array:
        """Simulate candidates and sample what the encoders show.

        Args:
            sizes: Sizes of all effects one after the other, (n_candidates, total sizes).

        Returns:
            Positions, (n_candidates, n_samples) [rad], in the order of windows, joints, times; NaN in
            windows in which the simulation blew up.
        """
        shown = np.empty((sizes.shape[0], self.n_samples))
        longest = max(window.n_ticks for window in self.windows)
        row_bytes = 2 * 8 * longest * len(self.compiled.robot.joints) * len(self.windows)
        at_once = max(1, MEMORY_BYTES // row_bytes)
        for first in range(0, sizes.shape[0], at_once):
            part = slice(first, first + at_once)
            shown[part] = _Run(self, sizes[part]).positions()
        return shown

    def columns(self, window: int, joint: int) -> slice:
        """Return the place of the positions of a joint in a window, in the second axis of `positions`."""
        k = window * len(self.compiled.robot.joints) + joint
        return slice(int(self._ends[k]), int(self._ends[k + 1]))


@dataclass(slots=True)
class _Acting:
    """An effect in a run."""

    effect: Effect
    size: Array
    """(n_sims, n_sizes)."""
    joint: int
    """-1 if its place is no joint."""
    memory: dict[str, Array]


class _Run:
    """One batch: simulation s is candidate s % n_candidates in the window s // n_candidates, longest first."""

    def __init__(self, engine: Engine, sizes: Array) -> None:
        self.engine = engine
        self.compiled: Compiled = engine.compiled
        self.robot = engine.compiled.robot
        self.n_candidates = sizes.shape[0]
        self.windows = [engine.windows[w] for w in engine._longest_first]
        self.n_sims = self.n_candidates * len(self.windows)
        self.batch = mujoco.batch.Batch(self.robot.model, self.n_sims, nthread=engine.n_threads)
        names = [joint.name for joint in self.robot.joints]
        self.acting = []
        first = 0
        for effect in engine.effects:
            n = len(effect.sizes)
            size = np.tile(sizes[:, first : first + n], (len(self.windows), 1))
            place = names.index(effect.place) if effect.place in names else -1
            self.acting.append(_Acting(effect, np.ascontiguousarray(size, dtype=float), place, {}))
            first += n
        self.fields = self._set_model()
        self.command = self._commands()
        self._start()

    def _with(self, hook: str) -> list[_Acting]:
        return [one for one in self.acting if one.effect.overrides(hook)]

    def _set_model(self) -> Fields:
        model, dof = self.robot.model, self.compiled.dof
        kp, kd = nominal_gains(self.robot)
        limit = np.array([joint.torque_limit_Nm for joint in self.robot.joints])
        gain = np.repeat([window.gain for window in self.windows], self.n_candidates, axis=0)

        def rows(values: Array) -> Array:
            return np.tile(values, (self.n_sims, 1))

        fields = Fields(
            kp_Nm_rad=kp * gain,
            kd_Nms_rad=rows(kd),
            torque_limit_Nm=rows(limit),
            damping_Nms_rad=rows(model.dof_damping[dof]),
            frictionloss_Nm=rows(model.dof_frictionloss[dof]),
            armature_kgm2=rows(model.dof_armature[dof]),
            motor_dof=np.tile(dof, (self.n_sims, 1)),
            encoder_dof=np.tile(dof, (self.n_sims, 1)),
            batch=self.batch,
        )
        for one in self._with("set_model"):
            one.effect.set_model(one.size, fields, self.robot)
        fields.frictionloss_Nm = np.maximum(fields.frictionloss_Nm, 0.0)
        self.row = np.arange(self.n_sims)[:, None]
        self.friction = self.batch.expand("dof_frictionloss")
        for field, values in (
            (self.batch.expand("dof_damping"), np.maximum(fields.damping_Nms_rad, 0.0)),
            (self.batch.expand("dof_armature"), np.maximum(fields.armature_kgm2, 0.0)),
            (self.friction, fields.frictionloss_Nm),
        ):
            field[:, dof] = 0.0
            field[self.row, fields.motor_dof] = values
        self.limits = self.batch.expand("actuator_forcerange")
        self.gainprm = self.batch.expand("actuator_gainprm")
        self.biasprm = self.batch.expand("actuator_biasprm")
        self._write_limit(fields.torque_limit_Nm, self.n_sims)
        self._write_gain(fields.kp_Nm_rad, fields.kd_Nms_rad, self.n_sims)
        self.batch.set_const()
        return fields

    def _write_limit(self, limit_Nm: Array, n: int) -> None:
        high = np.minimum(limit_Nm, UNLIMITED_Nm)
        self.limits[:n, self.compiled.actuator, 0] = -high
        self.limits[:n, self.compiled.actuator, 1] = high

    def _write_gain(self, kp: Array, kd: Array, n: int) -> None:
        gain, bias = laws(self.robot, kp, kd)
        self.gainprm[:n, self.compiled.actuator, 0] = gain
        self.biasprm[:n, self.compiled.actuator, :3] = bias

    def _commands(self) -> Array:
        """Compute the commands as they arrive, (n_ticks, n_sims, n_joints)."""
        longest = self.windows[0].n_ticks
        command = np.zeros((longest, self.n_sims, len(self.robot.joints)))
        decode, shape = self._with("decode"), self._with("shape_command")
        for w, window in enumerate(self.windows):
            sims = slice(w * self.n_candidates, (w + 1) * self.n_candidates)
            for j, joint in enumerate(self.robot.joints):
                arrived = np.tile(window.command[:, j], (self.n_candidates, 1))
                for one in shape:
                    if one.joint == j:
                        arrived = one.effect.shape_command(
                            one.size[sims], arrived, self.robot.control_period_s
                        )
                if joint.mode is ControlMode.POSITION:
                    for one in reversed(decode):
                        if one.joint == j:
                            arrived = one.effect.decode(one.size[sims], arrived)
                command[: window.n_ticks, sims, j] = arrived[:, window.n_lead :].T
        return command

    def _start(self) -> None:
        q = np.repeat([window.q_rad for window in self.windows], self.n_candidates, axis=0)
        for one in reversed(self._with("decode")):
            q[:, one.joint] = one.effect.decode(one.size, q[:, [one.joint]])[:, 0]
        v = np.repeat([window.v_rad_s for window in self.windows], self.n_candidates, axis=0)
        for dof in (self.fields.motor_dof, self.compiled.dof):
            self.batch.bind("qpos")[self.row, self._qpos(dof)] = q
            self.batch.bind("qvel")[self.row, dof] = v
        self.batch.bind("ctrl")[:, self.compiled.actuator] = self.command[0]

    def _qpos(self, dof: Integers) -> Integers:
        model = self.robot.model
        return np.asarray(model.jnt_qposadr[model.dof_jntid[dof]], np.int64)

    def positions(self) -> Array:
        """Simulate and sample, (n_candidates, n_samples)."""
        path, failed = self._simulate()
        engine = self.engine
        shown = np.empty((self.n_candidates, engine.n_samples))
        delay, encode = self._with("sample_delay_s"), self._with("encode")
        for w, index in enumerate(engine._longest_first):
            window = self.windows[w]
            sims = slice(w * self.n_candidates, (w + 1) * self.n_candidates)
            for j, time_s in enumerate(window.sample_time_s):
                late_s = np.zeros((self.n_candidates, 1))
                for one in delay:
                    if one.joint == j:
                        late_s[:, 0] += one.effect.sample_delay_s(one.size[sims])
                q = _sample(path[: window.n_ticks + 1, sims, j], time_s - late_s, self.robot.control_period_s)
                for one in encode:
                    if one.joint == j:
                        q = one.effect.encode(one.size[sims], q)
                shown[:, engine.columns(index, j)] = np.where(failed[sims, None], np.nan, q)
        return shown

    def _simulate(self) -> tuple[Array, Flags]:
        """Step all windows; return the positions, (n_ticks + 1, n_sims, n_joints), and which sims failed."""
        longest = self.windows[0].n_ticks
        path = np.empty((longest + 1, self.n_sims, len(self.robot.joints)))
        encoder = self._qpos(self.fields.encoder_dof)
        path[0] = self.batch.bind("qpos")[self.row, encoder]
        failed = np.zeros(self.n_sims, dtype=bool)
        loop = _Loop(self)
        self._call(failed, self.batch.forward)
        ends = [window.n_ticks for window in self.windows]
        for first, last in zip([0, *sorted(set(ends))], sorted(set(ends)), strict=False):
            n_alive = self.n_candidates * sum(end > first for end in ends)
            loop.cut(n_alive, failed)
            for k in range(first, last):
                loop.tick(k)
                self._call(failed, loop.step)
                path[k + 1, :n_alive] = loop.qpos[self.row[:n_alive], encoder[:n_alive]]
                if self.batch.warning.any():
                    failed |= self.batch.warning.reshape(self.n_sims, -1).any(axis=1)
                    self.batch.warning[:] = 0
                    loop.cut(n_alive, failed)
        return path, failed

    def _call(self, failed: Flags, job: Callable[[], None]) -> None:
        try:
            job()
        except mujoco.batch.SimulationError as error:
            failed[error.ids] = True


class _Loop:
    """What happens in each control period, for the simulations that are alive: the first ones."""

    def __init__(self, run: _Run) -> None:
        self.run = run
        self.n_steps = round(run.robot.control_period_s / run.robot.model.opt.timestep)
        batch = run.batch
        self.qpos, self.qvel, self.ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self.applied = batch.bind("qfrc_applied")
        self.acts, self.frictions, self.torques = (
            run._with(hook) for hook in ("act", "friction_Nm", "torque_Nm")
        )
        self.has_rotors = bool((run.fields.motor_dof != run.compiled.dof).any())
        self.motor_qpos, self.encoder_qpos = run._qpos(run.fields.motor_dof), run._qpos(run.fields.encoder_dof)
        self.has_effects = bool(self.acts or self.frictions or self.torques or self.has_rotors)
        if self.has_effects:
            self.forces = [batch.bind(f"qfrc_{name}") for name in ("bias", "smooth", "constraint")]
            self.armature_kgm2 = run.fields.armature_kgm2 * (run.fields.motor_dof == run.compiled.dof)
            self.qacc, self.motor = batch.bind("qacc"), batch.bind("actuator_force")
        modes = [joint.mode for joint in run.robot.joints]
        self.has_position_loop = np.array([mode is ControlMode.POSITION for mode in modes])
        self.has_velocity_loop = np.array([mode is ControlMode.VELOCITY for mode in modes])
        self.temperature = np.repeat(
            [window.temperature_degC for window in run.windows], run.n_candidates, axis=0
        )
        self.is_switched = not all(window.enabled.all() for window in run.windows)
        self.enabled = np.ones((run.command.shape[0], len(run.windows), len(run.robot.joints)))
        for w, window in enumerate(run.windows):
            self.enabled[: window.n_ticks, w] = window.enabled
        self.factor = np.ones((run.n_sims, len(run.robot.joints)))

    def cut(self, n: int, failed: Flags) -> None:
        """Keep the first n simulations, and step those of them that have not failed."""
        self.n = n
        self.ids = np.flatnonzero(~failed[:n])
        self.factor = self.factor[:n]
        for one in self.run.acting:
            one.size = one.size[:n]
            one.memory = {name: kept[:n] for name, kept in one.memory.items()}

    def step(self) -> None:
        """Step the simulations that are alive through a control period."""
        self.run.batch.step(self.ids, nstep=self.n_steps)

    def tick(self, k: int) -> None:
        """Set the inputs of a control period."""
        run, n = self.run, self.n
        if not self.has_effects:
            self.ctrl[:n, run.compiled.actuator] = run.command[k, :n]
            if self.is_switched:
                self._write_gain(self._on(k))
            return
        fields, dof = run.fields, run.compiled.dof
        bias, smooth, constraint = (force[:n, dof] for force in self.forces)
        state = State(
            time_s=np.full(n, k * run.robot.control_period_s),
            q_rad=self.qpos[:n, run.compiled.qpos],
            v_rad_s=self.qvel[:n, dof],
            load_Nm=bias + smooth + constraint - self.armature_kgm2[:n] * self.qacc[:n, dof],
            temperature_degC=self.temperature[:n],
        )
        tick = Tick(
            state=state,
            command=run.command[k, :n],
            applied_Nm=np.zeros_like(state.q_rad),
            frictionloss_Nm=fields.frictionloss_Nm[:n].copy(),
            torque_limit_Nm=fields.torque_limit_Nm[:n].copy(),
            gain=np.ones_like(state.q_rad),
            motor_Nm=self.motor[:n, run.compiled.actuator],
            period_s=run.robot.control_period_s,
            memory={},
        )
        for one in self.acts:
            tick.memory = one.memory
            one.effect.act(one.size, tick)
        for one in self.frictions:
            tick.frictionloss_Nm[:, one.joint] += one.effect.friction_Nm(one.size, state)
        for one in self.torques:
            tick.applied_Nm[:, one.joint] += one.effect.torque_Nm(one.size, state)
        self._write(k, tick)

    def _on(self, k: int) -> Array:
        return np.repeat(self.enabled[k], self.run.n_candidates, axis=0)[: self.n]

    def _write(self, k: int, tick: Tick) -> None:
        run, n, dof = self.run, self.n, self.run.compiled.dof
        if self.has_rotors:
            row, fields = run.row[:n], run.fields
            turned = self.qpos[row, self.motor_qpos[:n]] - self.qpos[row, self.encoder_qpos[:n]]
            turning = self.qvel[row, fields.motor_dof[:n]] - self.qvel[row, fields.encoder_dof[:n]]
            # the loop of an actuator closes at the rotor; shifted, it closes at the encoder
            tick.command += turned * self.has_position_loop + turning * self.has_velocity_loop
        self.ctrl[:n, run.compiled.actuator] = tick.command
        if self.acts or self.torques:
            self.applied[:n, dof] = tick.applied_Nm
        if self.acts or self.frictions:
            run.friction[run.row[:n], run.fields.motor_dof[:n]] = tick.frictionloss_Nm
        if self.acts:
            run._write_limit(tick.torque_limit_Nm, n)
        if self.acts or self.is_switched:
            self._write_gain(tick.gain * self._on(k) if self.is_switched else tick.gain)

    def _write_gain(self, factor: Array) -> None:
        if np.array_equal(factor, self.factor):
            return
        self.factor = factor
        fields = self.run.fields
        self.run._write_gain(
            fields.kp_Nm_rad[: self.n] * factor, fields.kd_Nms_rad[: self.n] * factor, self.n
        )


def _sample(path: Array, time_s: Array, period_s: float) -> Array:
    """Interpolate positions at control periods, (n_ticks + 1, n_candidates), to times, (n_candidates, n)."""
    position = np.clip(time_s / period_s, 0.0, path.shape[0] - 1.0)
    index = np.minimum(position.astype(int), path.shape[0] - 2)
    share = position - index
    row = np.arange(path.shape[1])[:, None]
    low = path[index, row]
    return np.asarray(low + share * (path[index + 1, row] - low))
