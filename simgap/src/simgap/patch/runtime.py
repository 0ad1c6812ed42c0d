"""Effects in a simulation of one's own: what a patched model cannot express, applied in each control period.

    model = mujoco.MjModel.from_xml_path("patched.xml")
    data = mujoco.MjData(model)
    runtime = RuntimeEffects.from_toml(model, "runtime.toml")
    for command in commands:
        runtime.act(model, data, command)
        mujoco.mj_step(model, data, n_steps)  # of one control period
        print(runtime.shown(data))

It calls the same hooks as the engine of the diagnosis, with one simulation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.common.errors import RobotError
from simgap.common.toml import read_toml
from simgap.effects.effect import BODY_HOOKS, HISTORY_S, RUN_HOOKS, Effect, State, Tick
from simgap.patch.patch import FORMAT
from simgap.patch.text import read_effect
from simgap.robot import ControlMode
from simgap.simulation.compiled import HARD_IMPEDANCE
from simgap.simulation.periods import middle_s

SWITCHED: Final = ("dof_damping", "dof_armature", "dof_M0")
"""Numbers that differ without power; MuJoCo takes the inertia of some simple joints from the last."""
CHANGED: Final = (
    *(*SWITCHED, "dof_frictionloss"),
    *("actuator_gainprm", "actuator_biasprm", "actuator_forcelimited", "actuator_forcerange"),
)
"""Numbers of a model that a wrapper changes."""
_left: Final[WeakKeyDictionary[mujoco.MjModel, tuple[dict[str, Array], dict[str, Array]]]] = (
    WeakKeyDictionary()
)
"""The numbers of each model without a wrapper, and as the last one left them."""


def _copy_numbers(model: mujoco.MjModel) -> dict[str, Array]:
    return {name: getattr(model, name).copy() for name in CHANGED}


@dataclass(frozen=True, slots=True)
class RuntimeJoint:
    """A joint of the patched model."""

    name: str
    joint: str
    """Its name in the model."""
    actuator: str
    mode: ControlMode
    back_emf_Nms_rad: float
    """Damping that a motor without power lacks."""
    armature_off_kgm2: float
    """Armature that it has more, for steps of second order."""
    rotor: str = ""
    """Hinge that the motor turns in place of the joint; empty if there is none."""
    sees_output: bool = False
    """True if the encoder sees the joint, not the rotor."""


@dataclass(slots=True)
class _Acting:
    effect: Effect
    size: Array
    """(1, n_sizes)."""
    joint: int
    """-1 if its place is no joint."""
    memory: dict[str, Array] = field(default_factory=dict)


class RuntimeEffects:
    """Effects that act while a model runs; `place` begins a new run, as does a time that goes back."""

    def __init__(
        self,
        model: mujoco.MjModel,
        effects: Sequence[tuple[Effect, Array]],
        joints: Sequence[RuntimeJoint],
        control_period_s: float,
    ) -> None:
        """Keep the numbers of the patched model, without what another wrapper has left in it.

        Args:
            effects: Effects with their sizes, (n_sizes,) in the units of their names.
            joints: Joints in the order of commands.
            control_period_s: Time between two commands, a whole number of time steps.

        Raises:
            RobotError: It is no whole number of time steps.
        """
        names = [joint.name for joint in joints]
        self._period_s = control_period_s
        self.n_steps = round(control_period_s / model.opt.timestep)
        """Time steps of a control period."""
        if self.n_steps < 1 or abs(self.n_steps * model.opt.timestep - control_period_s) > 1e-9:
            raise RobotError(
                f"time step: {model.opt.timestep:g} s is no whole part of the control period of "
                f"{control_period_s:g} s; make the patch anew"
            )
        self._joints = tuple(joints)
        self._qpos, self._dof = _places(model, [joint.joint for joint in joints])
        turned = [joint.rotor or joint.joint for joint in joints]
        self._motor_qpos, self._motor_dof = _places(model, turned)
        sees_motor = np.array([bool(joint.rotor) and not joint.sees_output for joint in joints])
        self._shown = np.where(sees_motor, self._motor_qpos, self._qpos)
        self._motor: Integers = np.array([_actuator(model, joint.actuator) for joint in joints])
        self._acting = [
            _Acting(effect, size[None, :], names.index(effect.place) if effect.place in names else -1)
            for effect, size in effects
        ]
        motor = self._motor
        self._gear = model.actuator_gear[motor, 0].copy()
        now = _copy_numbers(model)
        before, left = _left.get(model, (now, now))
        # what the last wrapper left is not of the model; what was changed since is
        self._own = {name: np.where(now[name] == left[name], before[name], now[name]) for name in CHANGED}
        friction_Nm, gain, bias, is_limited, limits = (self._own[name] for name in CHANGED[len(SWITCHED) :])
        _left[model] = self._own, now
        self._friction_Nm = friction_Nm[self._motor_dof]
        more = np.array([joint.armature_off_kgm2 for joint in joints])
        self._back_emf_Nms_rad = np.array([joint.back_emf_Nms_rad for joint in joints])
        self._off = dict(zip(SWITCHED, (-self._back_emf_Nms_rad, more, more), strict=True))
        """What is added to the numbers of a motor that loses its power."""
        self._powered = {name: self._own[name][self._motor_dof] for name in SWITCHED}
        """Numbers before it did."""
        kept = [now[name][self._motor_dof] == own for name, own in self._powered.items()]
        self._on: Flags = np.all(kept, axis=0)  # another wrapper may have left it without
        # in the model the limit is that of the actuator
        high = np.where(is_limited[motor], limits[motor, 1], np.inf)
        self._limit_Nm = high * np.abs(self._gear)
        self._gain, self._bias = gain[motor, 0], bias[motor, :3]
        of_gear = [joint.mode in (ControlMode.POSITION, ControlMode.VELOCITY) for joint in joints]
        self._has_kp = np.array([joint.mode is not ControlMode.VELOCITY for joint in joints])
        self._ctrl_scale = np.where(of_gear, self._gear, 1.0)
        self._path_s, self._path_rad = np.zeros(0), np.zeros((0, len(joints)))
        self._last_share = 0.5 * model.opt.timestep / control_period_s
        self._last_command: Array | None = None

    @classmethod
    def from_toml(cls, model: mujoco.MjModel, path: str | Path) -> Self:
        """Read a file of a patch, and run files of effects that it names; RobotError if it does not fit."""
        path = Path(path)
        content = read_toml(path)
        if content.get("format") != FORMAT:
            raise RobotError(f"{path}: format: is not {FORMAT!r}; name a runtime file that a patch wrote")
        try:
            joints = [RuntimeJoint(**{**one, "mode": ControlMode(one["mode"])}) for one in content["joints"]]
            effects = [read_effect(one, path) for one in content.get("effects", [])]
            made = cls(model, effects, joints, float(content["control_period_s"]))
            if (model.dof_solimp[made._dof] != HARD_IMPEDANCE).any():  # every patch sets it
                raise ValueError("its dry friction is not that of a patch")
        except (KeyError, TypeError, ValueError) as error:
            raise RobotError(f"{path}: does not fit the model ({error}); use the patched model") from error
        for one, table in zip(made._acting, content.get("effects", []), strict=True):
            effect, at = one.effect, one.joint
            is_moved = table.get("place") != effect.place or getattr(effect, "index", at) != at
            if is_moved or (at < 0 and effect.overrides(*{*RUN_HOOKS} - BODY_HOOKS)):
                raise RobotError(f"{path}: {effect.key}: its places are not one joint; make the patch anew")
        return made

    def act(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        command: Array,
        temperature_degC: Array | None = None,
        gain: Array | float = 1.0,
        is_on: Flags | bool = True,
    ) -> None:
        """Set the inputs of one control period; call it before the first of its `n_steps` time steps.

        Args:
            model: Patched model; dry friction, torque limits and gains are set anew in each period, damping
                and armature where a motor gets or loses its power.
            command: Commands, (n_joints,), in the unit of each control mode.
            temperature_degC: Temperatures of the joints, (n_joints,), where effects depend on them.
            gain: Values of the gain columns of the robot file, (n_joints,).
            is_on: Whether the motors have torque, (n_joints,).

        Raises:
            RobotError: There is not a command for each joint, or another number is wrong.
        """
        command = self._numbers("command", command)
        gain = self._numbers("gain", gain, "a number from 0", lambda one: (one >= 0.0) & (one < np.inf))
        on = self._numbers("is_on", is_on, "True or False", lambda one: (one == 0.0) | (one == 1.0))
        heat = self._numbers("temperature_degC", temperature_degC, rule=lambda one: ~np.isinf(one))
        self._remember(data)
        if self._last_command is None:  # a run before has left its last numbers
            self._set_model(model, self._friction_Nm, self._limit_Nm, 1.0, 1.0)
            self._switch(model, np.ones(self._on.shape, bool))
            mujoco.mj_forward(model, data)
        arrived = self._arrived(command)
        tick = self._tick(model, data, arrived, heat)
        motor = self._motor
        self._close_loops(data, tick.command[0])
        data.ctrl[motor] = tick.command[0] * self._ctrl_scale
        data.qfrc_applied[self._dof] = tick.applied_Nm[0]
        ratio = tick.gain[0] * on
        self._set_model(model, tick.frictionloss_Nm[0], tick.torque_limit_Nm[0], ratio, gain)
        self._switch(model, on > 0.0)
        _left[model] = self._own, _copy_numbers(model)

    def _switch(self, model: mujoco.MjModel, on: Flags) -> None:
        """Take back-EMF from motors that lose their power, and give back what those had that get it."""
        dof, lost, back = self._motor_dof, self._on & ~on, on & ~self._on
        for name, more in self._off.items():
            values, powered = getattr(model, name), self._powered[name]
            powered[lost] = values[dof[lost]]
            values[dof[lost]] += more[lost]
            values[dof[back]] = powered[back]
        self._on = on

    def _set_model(
        self,
        model: mujoco.MjModel,
        frictionloss_Nm: Array,
        torque_limit_Nm: Array,
        ratio: Array | float,
        gain: Array | float,
    ) -> None:
        """Set dry friction, torque limits and gains, (n_joints,) each; `gain` scales that of the position."""
        motor = self._motor
        model.dof_frictionloss[self._motor_dof] = frictionloss_Nm
        of_speed = np.broadcast_to(ratio, motor.shape)
        of_position = of_speed * gain
        model.actuator_gainprm[motor, 0] = self._gain * np.where(self._has_kp, of_position, of_speed)
        model.actuator_biasprm[motor, :3] = self._bias * np.stack((of_speed, of_position, of_speed), axis=1)
        limit = np.maximum(torque_limit_Nm, 0.0) / np.abs(self._gear)
        is_limited = np.isfinite(limit)
        model.actuator_forcelimited[motor] = is_limited
        model.actuator_forcerange[motor[is_limited]] = np.stack((-limit, limit), axis=1)[is_limited]

    def shown(self, data: mujoco.MjData) -> Array:
        """Return what the encoders show at the end of a control period, (n_joints,) [rad]."""
        self._remember(data)
        late_s = np.zeros(self._qpos.size)
        for one in self._with("sample_delay_s"):
            late_s[one.joint] += float(one.effect.sample_delay_s(one.size)[0])
        shown = np.array(
            [np.interp(data.time - late, self._path_s, self._path_rad[:, j]) for j, late in enumerate(late_s)]
        )
        for one in self._with("encode"):
            shown[one.joint] = one.effect.encode(one.size, shown[None, [one.joint]])[0, 0]
        return shown

    def place(self, data: mujoco.MjData, shown_rad: Array) -> None:
        """Set the joints such that the encoders show these positions, (n_joints,), and begin a new run.

        RobotError without a position for each joint.
        """
        q_rad = self._numbers("positions", shown_rad)
        for one in reversed(self._with("decode")):
            q_rad[one.joint] = one.effect.decode(one.size, q_rad[None, [one.joint]])[0, 0]
        data.qpos[self._qpos] = data.qpos[self._motor_qpos] = q_rad
        self._begin()

    def _begin(self) -> None:
        """Forget the run before."""
        self._last_command = None
        for one in self._acting:
            one.memory.clear()
        self._path_s, self._path_rad = self._path_s[:0], self._path_rad[:0]

    def _numbers(
        self, what: str, given: Any, right: str = "a number", rule: Callable[[Array], Flags] | None = None
    ) -> Array:
        """Return a copy of right numbers, (n_joints,); with a rule of its own, one may stand for all."""
        numbers = np.array(given, dtype=float)
        if rule and not numbers.ndim:
            numbers = np.full(self._qpos.shape, numbers)
        if numbers.shape != self._qpos.shape or not (rule or np.isfinite)(numbers).all():
            raise RobotError(f"{what}: is {given}; give {right} for each of {self._qpos.size} joints")
        return numbers

    def _with(self, hook: str) -> list[_Acting]:
        return [one for one in self._acting if one.effect.overrides(hook)]

    def _remember(self, data: mujoco.MjData) -> None:
        if self._path_s.size and data.time < self._path_s[-1]:  # as after mj_resetData
            self._begin()
        most, before = round(HISTORY_S / self._period_s), self._path_s < data.time
        self._path_s = np.append(self._path_s[before], data.time)[-most:]
        self._path_rad = np.concatenate([self._path_rad[before], data.qpos[None, self._shown]])[-most:]

    def _arrived(self, command: Array) -> Array:
        """Return the command as it arrives, (n_joints,).

        As in the engine, it is the mean of the held command over a control period that begins half a step
        earlier: a step uses one force from half a step before its state to half a step after it.
        """
        last = command if self._last_command is None else self._last_command
        self._last_command = command.copy()
        arrived = (command + self._last_share * (last - command))[None, :]
        for one in self._with("shape_command"):
            j = one.joint
            arrived[:, j] = one.effect.next_command(one.size, arrived[:, j], self._period_s, one.memory)
        for one in reversed(self._with("decode")):
            if self._joints[one.joint].mode is ControlMode.POSITION:
                arrived[:, [one.joint]] = one.effect.decode(one.size, arrived[:, [one.joint]])
        return np.asarray(arrived[0])

    def _close_loops(self, data: mujoco.MjData, command: Array) -> None:
        """Shift commands so that the loop closes at the encoder at the output, not at the rotor."""
        for j, joint in enumerate(self._joints):
            if joint.rotor and joint.sees_output and joint.mode is ControlMode.POSITION:
                command[j] += data.qpos[self._motor_qpos[j]] - data.qpos[self._qpos[j]]
            elif joint.rotor and joint.sees_output and joint.mode is ControlMode.VELOCITY:
                command[j] += data.qvel[self._motor_dof[j]] - data.qvel[self._dof[j]]

    def _tick(
        self, model: mujoco.MjModel, data: mujoco.MjData, command: Array, temperature_degC: Array
    ) -> Tick:
        """Let the effects act, as the engine does."""
        dof = self._dof
        force_Nm = data.qfrc_bias + data.qfrc_smooth + data.qfrc_constraint - model.dof_armature * data.qacc
        motor_Nm = data.actuator_force[self._motor] * self._gear
        motor_Nm -= self._back_emf_Nms_rad * self._on * data.qvel[dof]
        ahead_s = middle_s(self.n_steps, model.opt.timestep)
        v_rad_s = data.qvel[None, dof]
        state = State(
            time_s=np.array([data.time]),
            q_rad=data.qpos[None, self._qpos] + ahead_s * v_rad_s,
            v_rad_s=v_rad_s + ahead_s * data.qacc[None, dof],
            load_Nm=force_Nm[None, dof],
            temperature_degC=temperature_degC[None, :],
        )
        tick = Tick(
            state=state,
            command=command[None, :].copy(),
            applied_Nm=np.zeros((1, dof.size)),
            frictionloss_Nm=self._friction_Nm[None, :].copy(),
            torque_limit_Nm=self._limit_Nm[None, :].copy(),
            gain=np.ones((1, dof.size)),
            motor_Nm=motor_Nm[None, :],
            period_s=self._period_s,
            memory={},
        )
        for one in self._with("act"):
            tick.memory = one.memory
            one.effect.act(one.size, tick)
        for one in self._with("friction_Nm"):
            tick.frictionloss_Nm[:, one.joint] += one.effect.friction_Nm(one.size, state)
        for one in self._with("torque_Nm"):
            tick.applied_Nm[:, one.joint] += one.effect.torque_Nm(one.size, state)
        return tick


def _places(model: mujoco.MjModel, joints: Sequence[str]) -> tuple[Integers, Integers]:
    """Return the places of joints in positions and in degrees of freedom."""
    found = [model.joint(name) for name in joints]
    return np.array([int(one.qposadr[0]) for one in found]), np.array([int(one.dofadr[0]) for one in found])


def _actuator(model: mujoco.MjModel, name: str) -> int:
    """Return an actuator by its name, or by that of its joint if it has none."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if number >= 0:
        return int(number)
    driving = np.flatnonzero(model.actuator_trnid[:, 0] == model.joint(name).id)
    if not driving.size:
        raise KeyError(f"no actuator {name!r}")
    return int(driving[0])
