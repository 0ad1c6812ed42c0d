"""Control periods of a batch: effects read the motion, and change the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco.batch
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Fields, State, Tick
from simgap.simulation.compiled import Compiled, Places, Rotors, UNLIMITED_Nm, control_laws, powered_numbers


@dataclass(slots=True)
class Acting:
    """An effect in a batch."""

    effect: Effect
    size: Array
    """(n_sims, n_sizes)."""
    joint: int
    """-1 if its place is no joint."""
    memory: dict[str, Array]


class ColumnView:
    """The columns of the joints in an array of the batch, for its first simulations."""

    def __init__(self, array: Array, places: Places, n: int) -> None:
        """Make a view if the columns follow one another, else a copy."""
        self._rows, self._places = array[:n], places
        self.values = array[:n, places]
        """(n, n_joints); the same array all the time."""
        self.is_view = isinstance(places, slice)
        """True if the values follow the batch."""

    def read(self) -> None:
        """Bring a copy up to date."""
        self.values[...] = self._rows[:, self._places]

    def write(self, values: Array) -> None:
        """Set the values in the batch."""
        if values is not self.values:
            self.values[...] = values
        if not self.is_view:
            self._rows[:, self._places] = values


class Actuators:
    """The affine actuators of a batch."""

    def __init__(self, compiled: Compiled, batch: mujoco.batch.Batch, fields: Fields) -> None:
        """Expand their numbers, and set them."""
        self._places = compiled.actuator
        self._limits = batch.expand("actuator_forcerange")
        self._gain, self._bias = batch.expand("actuator_gainprm"), batch.expand("actuator_biasprm")
        self._nominal = control_laws(compiled.robot, fields.kp_Nm_rad, fields.kd_Nms_rad)
        self.limit(fields.torque_limit_Nm)
        self.scale(np.ones_like(fields.kp_Nm_rad))

    def limit(self, limit_Nm: Array) -> None:
        """Set the torque limits of the first simulations, (n, n_joints)."""
        high = np.minimum(limit_Nm, UNLIMITED_Nm)
        self._limits[: high.shape[0], self._places, 0] = -high
        self._limits[: high.shape[0], self._places, 1] = high

    def scale(self, factor: Array) -> None:
        """Multiply nominal gains of the first simulations by factors, (n, n_joints)."""
        n, (gain, bias) = factor.shape[0], self._nominal
        self._gain[:n, self._places, 0] = gain[:n] * factor
        self._bias[:n, self._places, :3] = bias[:n] * factor[..., None]


def middle_s(n_steps: int, step_s: float) -> float:
    """Return how far ahead the middle is of the time in which the inputs of a control period act.

    A step uses one force from half a step before its state to half a step after it. Inputs that follow from
    the motion there are right to first order, however long the period is.
    """
    return 0.5 * (n_steps - 1) * step_s


class Periods:
    """The inputs of the control periods of a batch, set by commands and effects."""

    def __init__(
        self,
        compiled: Compiled,
        batch: mujoco.batch.Batch,
        fields: Fields,
        rotors: Rotors,
        effects: Sequence[Acting],
        temperature_degC: Array,
    ) -> None:
        """Sort the effects by hooks; the batch is set to `fields`, temperatures are (n_sims, n_joints)."""
        self._compiled, self._batch, self._fields = compiled, batch, fields
        self._actuators = Actuators(compiled, batch, fields)
        self._rotors, self._qpos, self._qvel = rotors, batch.bind("qpos"), batch.bind("qvel")
        self._dry = batch.expand("dof_frictionloss")
        self._damping, self._inertia = batch.expand("dof_damping"), batch.expand("dof_armature")
        self._diagonal = batch.expand("dof_M0")
        self._back_emf = fields.back_emf_Nms_rad
        """Back-EMF of the motors that have power, (n, n_joints)."""
        self._temperature = temperature_degC
        self._effects = effects
        self._acts, self._frictions, self._torques = (
            [one for one in effects if one.effect.overrides(hook)]
            for hook in ("act", "friction_Nm", "torque_Nm")
        )
        self._enabled: Array | None = None
        self._has_effects = bool(self._acts or self._frictions or self._torques or rotors.close_at_output)
        self.are_steady = not (self._acts or rotors.close_at_output) and all(
            one.effect.is_steady for one in (*self._frictions, *self._torques)
        )
        """True if nothing but the commands changes from period to period."""
        self._period_s = compiled.robot.control_period_s
        self.n_steps = round(self._period_s / compiled.robot.model.opt.timestep)
        """Steps of a control period."""
        self._ahead_s = middle_s(self.n_steps, compiled.robot.model.opt.timestep)
        self.keep(temperature_degC.shape[0])

    def keep(self, n: int) -> None:
        """Go on with the first n simulations."""
        self.n = n
        for one in self._effects:
            one.size = one.size[:n]
            one.memory = {name: kept[:n] for name, kept in one.memory.items()}
        at, fields = self._compiled, self._fields

        def columns(name: str, places: Places) -> ColumnView:
            return ColumnView(self._batch.bind(name), places, n)

        self._ctrl = columns("ctrl", at.actuator)
        if self._enabled is not None:
            self._enabled = self._enabled[:n]
        if not self._has_effects:
            return
        # arrays for all periods: new ones in each of them would take a fifth of the time of a step
        self._armature, self._loss = ColumnView(self._inertia, at.dof, n), fields.frictionloss_Nm[:n]
        q, v = columns("qpos", at.qpos), columns("qvel", at.dof)
        self._forces = [
            columns(name, at.dof) for name in ("qfrc_bias", "qfrc_smooth", "qfrc_constraint", "qacc")
        ]
        self._motor = columns("actuator_force", at.actuator)
        every = (q, v, *self._forces, self._motor, self._armature)
        self._copies = [one for one in every if not one.is_view]
        self._applied, self._friction = columns("qfrc_applied", at.dof), ColumnView(self._dry, at.dof, n)
        self._now = now = q.values, v.values
        if self._ahead_s > 0.0:
            now = np.empty_like(q.values), np.empty_like(v.values)
        self._state = State(np.empty(n), *now, np.empty_like(q.values), self._temperature[:n])
        self._limit, self._gain = np.empty_like(q.values), np.empty_like(q.values)
        self._torque_columns = [self._applied.values[:, one.joint] for one in self._torques]
        self._friction_columns = [self._friction.values[:, one.joint] for one in self._frictions]

    def show(self, qpos: Array, shown_rad: Array) -> None:
        """Write the angles that encoders see.

        `qpos` [rad] is (..., n_sims, n_qpos). In `shown_rad`, (..., n_sims, n_joints), the first n
        simulations are written.
        """
        shown_rad[..., : self.n, :] = qpos[..., : self.n, self._compiled.qpos]
        self._rotors.show(qpos, shown_rad)

    def control(self, command: Array) -> Array:
        """Return the controls of all steps, (n_sims, n_periods n_steps, n_actuators).

        No effect changes the commands, (n_periods, n_sims, n_joints), any more.
        """
        control = np.zeros((command.shape[1], command.shape[0], self._compiled.robot.model.nu))
        control[..., self._compiled.actuator] = command.swapaxes(0, 1)
        return control if self.n_steps == 1 else np.repeat(control, self.n_steps, axis=1)

    def _enable(self, enabled: Array) -> None:
        """Give power to motors from now on: 1 where one has it, else 0, (n, n_joints)."""
        self._enabled = enabled
        self._actuators.scale(enabled)
        damping, armature = powered_numbers(self._compiled.robot, self._fields, enabled)
        n, before = len(enabled), self._inertia.copy()
        for field, value in ((self._damping, damping), (self._inertia, armature)):
            field[:n, self._compiled.dof] = value
            self._rotors.move(field, value)
        self._diagonal += self._inertia - before  # MuJoCo takes the inertia of some simple joints from it
        self._back_emf = self._fields.back_emf_Nms_rad[:n] * enabled

    def set_inputs(self, k: int, command: Array, enabled: Array | None = None) -> None:
        """Set the inputs of control period k; effects may change the commands, (n, n_joints).

        Motors have power from now on where `enabled`, (n, n_joints), is 1; None: nothing changes.
        """
        tick = self._tick(k, command) if self._has_effects else None
        if enabled is not None:  # the load in the tick is still that of the last period
            self._enable(enabled)
        if tick is not None:
            for one in self._acts:
                tick.memory = one.memory
                one.effect.act(one.size, tick)
            for one, column in zip(self._frictions, self._friction_columns, strict=True):
                column += one.effect.friction_Nm(one.size, tick.state)
            for one, column in zip(self._torques, self._torque_columns, strict=True):
                column += one.effect.torque_Nm(one.size, tick.state)
            self._rotors.close_loops(self._qpos, self._qvel, tick.command)
            command = tick.command
            self._applied.write(tick.applied_Nm)
            self._friction.write(tick.frictionloss_Nm)
            self._rotors.move(self._dry, tick.frictionloss_Nm)
            if self._acts:
                self._actuators.limit(tick.torque_limit_Nm)
                self._actuators.scale(tick.gain if self._enabled is None else tick.gain * self._enabled)
        self._ctrl.write(command)

    def _tick(self, k: int, command: Array) -> Tick:
        """Collect what effects may read and change."""
        for one in self._copies:
            one.read()
        bias, smooth, constraint, qacc = (one.values for one in self._forces)
        load = self._state.load_Nm
        np.multiply(self._armature.values, qacc, out=load)
        np.subtract(constraint, load, out=load)
        load += smooth
        load += bias
        self._state.time_s.fill(k * self._period_s)
        if self._ahead_s > 0.0:
            q, v = self._now
            np.add(q, self._ahead_s * v, out=self._state.q_rad)
            np.add(v, self._ahead_s * qacc, out=self._state.v_rad_s)
        self._friction.values[...] = self._loss
        self._applied.values.fill(0.0)
        motor_Nm = self._motor.values
        if self._acts:
            motor_Nm = motor_Nm - self._back_emf[: self.n] * self._now[1]
            self._limit[...] = self._fields.torque_limit_Nm[: self.n]
            self._gain.fill(1.0)
        return Tick(
            state=self._state,
            command=command,
            applied_Nm=self._applied.values,
            frictionloss_Nm=self._friction.values,
            torque_limit_Nm=self._limit,
            gain=self._gain,
            motor_Nm=motor_Nm,
            period_s=self._period_s,
            memory={},
        )
