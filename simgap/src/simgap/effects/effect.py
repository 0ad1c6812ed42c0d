"""The interface of an effect: a place, sizes, and what it changes.

An effect overrides only the hooks that it needs. Every hook gets its sizes for many simulations at once,
(n_sims, n_sizes). A size of 0 leaves every bit as it was: the effect is absent. Sizes are therefore chosen so
that 0 means absence: a velocity limit has the size 1/limit.

Hooks by kind of residual:
- simulation: `vary`, `set_model`, `shape_command`, `act`, `friction_Nm`, `torque_Nm`, `encode`, `decode`,
  `sample_delay_s`;
- inverse dynamics: `set_model`, `friction_Nm`, `torque_Nm` and `decode`, at the measured motion;
- second encoder: `deflection_rad`, `sample_delay_s` and `encode`.
"""

import math
from abc import ABC
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar, Final, Self

import mujoco
import mujoco.batch
import numpy as np

from simgap.arrays import Array, Flags
from simgap.logs import Motion, Signal
from simgap.robot import Robot, RobotJoint

HISTORY_S: Final = 0.5
"""Commands that a simulation without a known end remembers: more than twice the longest delay."""


class Family(StrEnum):
    """Kinds of effects, the middle level of a verdict; a program may have further ones of its own."""

    FRICTION = "friction"
    TRANSMISSION = "transmission"
    ACTUATION = "actuation"
    TIMING = "sensing and timing"
    GEOMETRY = "geometry"
    INERTIA = "inertia"
    CONTACT = "contact"
    EXTERNAL = "external torque"


@dataclass(frozen=True, slots=True)
class Size:
    """One number of an effect."""

    name: str
    """Name with its unit as a suffix, such as `coulomb_Nm`."""
    low: float
    high: float
    typical: float
    """Size at which the effect is worth a name: start of a fit, and its scale."""
    prior_std: float = math.inf
    """Width of a normal prior around 0: a fit adds the residual size / prior_std. Infinite: none."""


@dataclass(frozen=True, slots=True)
class State:
    """Motion at one instant of many simulations, (n_sims, n_joints), or at many samples, (n, n_joints)."""

    time_s: Array
    """(n_sims,) or (n,)."""
    q_rad: Array
    v_rad_s: Array
    load_Nm: Array
    """Torque that the gear carries, without friction: bias (gravity, Coriolis) + (M - armature) acceleration.

    It is `mj_rne` with accelerations. The simulation takes it from the last step: qfrc_bias + qfrc_smooth +
    qfrc_constraint - armature qacc, because qfrc_smooth + qfrc_constraint = M qacc.
    """
    temperature_degC: Array
    """(n_sims, n_joints); NaN where it is not logged."""


@dataclass(frozen=True, slots=True)
class Rotor:
    """Degree of freedom that the motor of a joint turns in place of the joint, in some simulations.

    It gets damping, dry friction and armature of the joint, and begins at its position and speed.
    """

    joint: int
    """Index of the joint in the robot."""
    name: str
    """Hinge of the model."""
    rows: Flags
    """(n_sims,), True where the motor turns it."""
    encoder_is_at_output: bool
    """True if log and controller see the joint, False if they see the rotor."""


@dataclass(slots=True)
class Fields:
    """Numbers of the model and of the controllers, a row a simulation; `set_model` changes them."""

    kp_Nm_rad: Array
    """(n_sims, n_joints). In the modes torque and current: torque per unit of the command."""
    kd_Nms_rad: Array
    back_emf_Nms_rad: Array
    """Damping that acts under power, outside the torque limit."""
    torque_limit_Nm: Array
    damping_Nms_rad: Array
    frictionloss_Nm: Array
    armature_kgm2: Array
    batch: mujoco.batch.Batch
    """For all other fields: `batch.expand(name)`; the engine calls `set_const` once after all effects."""
    rotors: list[Rotor] = field(default_factory=list)
    """Motors that turn something else than their joint; an effect may add one."""
    torque_scale: Array = field(default_factory=lambda: np.ones((1, 1)))
    """(n_sims, n_joints), torque over the logged one: inverse dynamics compares with it."""


@dataclass(slots=True)
class Tick:
    """Motion that an effect may read, and inputs that it may change, once in a control period."""

    state: State
    command: Array
    """(n_sims, n_joints), in the unit of the control mode; an effect may write it."""
    applied_Nm: Array
    """(n_sims, n_joints), torque beside that of the motor; 0 before the first effect."""
    frictionloss_Nm: Array
    """(n_sims, n_joints), dry friction; the value of `Fields` before the first effect."""
    torque_limit_Nm: Array
    """(n_sims, n_joints); the value of `Fields` before the first effect."""
    gain: Array
    """(n_sims, n_joints), factor on kp and kd, not on back-EMF, in this tick; 1 before the first effect."""
    motor_Nm: Array
    """(n_sims, n_joints), torque of the motors in the last step; only to read."""
    period_s: float
    memory: dict[str, Array]
    """State of the effect of its own, kept from tick to tick; its first axis is n_sims, which falls when
    simulations end: the engine cuts the last ones off."""


MODEL_HOOKS: Final = ("vary", "set_model")
"""Hooks of an effect that change the model before a simulation."""
RUN_HOOKS: Final = ("shape_command", "act", "friction_Nm", "torque_Nm", "encode", "decode", "sample_delay_s")
"""Hooks that act while a simulation runs."""
SIMULATION_HOOKS: Final = (*MODEL_HOOKS, *RUN_HOOKS)
TORQUE_HOOKS: Final = ("set_model", "friction_Nm", "torque_Nm", "decode")
"""Hooks that inverse dynamics uses."""
READING_HOOKS: Final = ("sample_delay_s", "encode")
"""Hooks of an effect that changes what an encoder shows, and nothing else."""
ENCODER_HOOKS: Final = ("deflection_rad", *READING_HOOKS)
"""Hooks that a second encoder uses."""
HOOKS: Final = (*SIMULATION_HOOKS, "deflection_rad")
BODY_HOOKS: Final = frozenset({*MODEL_HOOKS, "act"})
"""Hooks that get the whole robot; each other acts at the joint that is the place of its effect."""


class Effect(ABC):
    """A physical cause of a difference between a robot and its model; frozen dataclasses with a place."""

    has_shape: ClassVar[bool] = False
    """True if all sizes but the first give a form, and mean nothing while the first is 0."""
    is_steady: ClassVar[bool] = False
    """True if `friction_Nm` and `torque_Nm` do not change within a window, whatever the joint does."""
    place: str
    """Name of the joint, or of the body."""

    @property
    def name(self) -> str:
        """Standard term, such as "Coulomb friction"; mostly a class variable."""
        raise AttributeError(f"{type(self).__name__} has no name")

    @property
    def family(self) -> StrEnum:
        """Family; mostly a class variable too."""
        raise AttributeError(f"{type(self).__name__} has no family")

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Numbers of the effect; all 0: absent."""
        raise NotImplementedError

    @property
    def key(self) -> str:
        """Name that is unique in a catalogue."""
        return f"{self.place}: {self.name}"

    @property
    def nominal(self) -> float:
        """Value of the model to which the first size is added; 0 unless the effect is a base parameter."""
        return 0.0

    @property
    def parts(self) -> "tuple[Effect, ...]":
        """Effects, each with these sizes, whose hooks are called: itself, or one at each joint.

        One of several parts has no trial of its own: it may replace findings of its kind at their places.
        """
        return (self,)

    def is_plausible(self, size: Array, others: Mapping[str, Array]) -> bool:
        """Return whether sizes, (n_sizes,), can be real beside those of others at the place, by name."""
        return True

    def name_sizes(self, size: Array) -> dict[str, float]:
        """Return the sizes, (n_sizes,), by the names that tell their units."""
        return {one.name: float(value) for one, value in zip(self.sizes, size, strict=True)}

    def describe(self, size: Array) -> str:
        """Return the sizes, (n_sizes,), as text with units, in the form that a user expects."""
        return ", ".join(f"{name} = {value:.4g}" for name, value in self.name_sizes(size).items())

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Return the commands of this joint, (n_sims, n_ticks), as they arrive; each from those so far."""
        return command

    def next_command(self, size: Array, command: Array, period_s: float, memory: dict[str, Array]) -> Array:
        """Return one command as it arrives, (n_sims,): `shape_command` for a simulation with an open end.

        It shapes the commands of the last HISTORY_S again. An effect that remembers longer overrides it.
        """
        last = memory.get("commands", np.zeros((command.size, 0)))
        memory["commands"] = np.column_stack([last, command])[:, -round(HISTORY_S / period_s) :]
        return self.shape_command(size, memory["commands"], period_s)[:, -1]

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Change the model or the controller before the first step."""
        raise NotImplementedError

    def act(self, size: Array, tick: Tick) -> None:
        """Act before each control period; the engine itself adds `friction_Nm` and `torque_Nm`."""
        raise NotImplementedError

    def friction_Nm(self, size: Array, state: State) -> Array:
        """Return the dry friction that the effect adds at this joint, (n_sims,) [N m]; not negative."""
        raise NotImplementedError

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the torque that the effect applies to this joint, (n_sims,) [N m]."""
        raise NotImplementedError

    def sample_delay_s(self, size: Array) -> Array:
        """Return the age of the position of this joint at its time stamp, (n_sims,) [s]."""
        raise NotImplementedError

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Return what the encoder of this joint shows, (n_sims, n), at true positions (n_sims, n) [rad]."""
        raise NotImplementedError

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Return the inverse of `encode`: the controller and the start of a window use shown positions."""
        raise NotImplementedError

    def deflection_rad(self, size: Array, state: State) -> Array:
        """Return the angle of the output over that of the motor, (n_sims,) [rad]."""
        raise NotImplementedError

    def vary(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add bodies, joints or geoms to the model; at size 0 they do not move or touch."""
        raise NotImplementedError

    def overrides(self, *hooks: str) -> bool:
        """Return whether this effect has its own version of any of these hooks."""
        return any(getattr(type(self), hook) is not getattr(Effect, hook) for hook in hooks)


QUANTILE: Final = 0.995
"""Quantile that stands for the maximum of a noisy quantity."""
BASE_PRIOR: Final = 10.0
"""Width of the prior of a base effect in typical sizes; where the nominal value is larger, that is the width.
Data that show a typical size outweigh it a hundredfold; data that show nothing leave the nominal value."""
SPAN: Final = 5
"""Samples over which a difference gives a speed: fewer show the steps of the encoder."""


@dataclass(frozen=True, slots=True)
class JointScales:
    """Nominal numbers of one joint, and its ranges over all motions that are fitted."""

    damping_Nms_rad: float
    """Of the model, as are stiffness, friction and armature."""
    stiffness_Nm_rad: float
    frictionloss_Nm: float
    armature_kgm2: float
    low_rad: float
    high_rad: float
    speed_rad_s: float
    acceleration_rad_s2: float
    command_low: float
    """In the unit of the control mode; NaN without a command."""
    command_high: float
    torque_Nm: float
    """Torque limit. Where it is unlimited: the largest of logged torque and that of gravity and inertia."""
    hottest_degC: float
    """NaN where the temperature is not logged."""
    coldest_degC: float


@dataclass(frozen=True, slots=True)
class JointEffect(Effect):
    """An effect at a joint."""

    place: str
    index: int
    joint: RobotJoint
    scales: JointScales
    is_base: bool = False
    """True for a nuisance, which is always fitted and never named."""
    known: float = 0.0
    """Size in an earlier result, from which that of a nuisance counts."""

    @classmethod
    def at(cls, robot: Robot, place: str, scales: Mapping[str, JointScales]) -> Self:
        """Return the effect at a joint."""
        index = [joint.name for joint in robot.joints].index(place)
        return cls(place, index, robot.joints[index], scales[place])

    def size_of(self, name: str, low: float, high: float, typical: float) -> Size:
        """Return a size whose name has the unit of the joint; of a base effect, with a prior around 0."""
        prior_std = max(BASE_PRIOR * typical, -low) if self.is_base else math.inf
        return Size(self.joint.name_of(name), low - self.known, high - self.known, typical, prior_std)


@dataclass(frozen=True, slots=True)
class AddedNumber(JointEffect):
    """Number of a joint beside that of the model."""

    number: ClassVar[str]
    """Name of the number in the fields of a simulation; in the scales of the joint, if it is the model's."""

    @property
    def nominal(self) -> float:
        """Value of the model."""
        return float(getattr(self.scales, self.number))

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add to the number."""
        getattr(fields, self.number)[:, self.index] += size[:, 0]


def joint_scales(robot: Robot, motions: Sequence[Motion]) -> dict[str, JointScales]:
    """Collect the ranges of joints over fitted motions, without joints that no motion logs."""
    found = {}
    for j, joint in enumerate(robot.joints):
        logs = [motion.joints[joint.name] for motion in motions if joint.name in motion.joints]
        if not logs:
            continue
        q = np.concatenate([log.position.value for log in logs])
        torques = [log.torque.value for log in logs if log.torque is not None]
        commands = [log.command.value for log in logs if log.command is not None]
        heats = [log.temperature.value for log in logs if log.temperature is not None]
        command = np.concatenate(commands) if commands else np.array([np.nan])
        heat = np.concatenate(heats) if heats else np.array([np.nan])
        speeds = [_slope(log.position) for log in logs]
        speed = _high([one.value for one in speeds])
        acceleration = _high([_slope(one).value for one in speeds])
        found[joint.name] = JointScales(
            damping_Nms_rad=float(robot.model.dof_damping[joint.dof_index]),
            stiffness_Nm_rad=float(robot.model.jnt_stiffness[robot.model.dof_jntid[joint.dof_index]]),
            frictionloss_Nm=float(robot.model.dof_frictionloss[joint.dof_index]),
            armature_kgm2=float(robot.model.dof_armature[joint.dof_index]),
            low_rad=float(q.min()),
            high_rad=float(q.max()),
            speed_rad_s=speed,
            acceleration_rad_s2=acceleration,
            command_low=float(command.min()),
            command_high=float(command.max()),
            torque_Nm=_torque_Nm(robot, j, q, acceleration, torques),
            hottest_degC=float(heat.max()),
            coldest_degC=float(heat.min()),
        )
    return found


def _slope(signal: Signal) -> Signal:
    """Differentiate a signal over a few samples."""
    time_s, value = signal.time_s, signal.value
    if time_s.size <= SPAN:
        return Signal(time_s[:1], np.zeros(1))
    first, last = time_s[:-SPAN], time_s[SPAN:]
    return Signal((last + first) / 2, (value[SPAN:] - value[:-SPAN]) / (last - first))


def _high(values: Sequence[Array]) -> float:
    """Return the largest usual magnitude; not 0, so that it can be a divisor."""
    return max(float(np.quantile(np.abs(np.concatenate(values)), QUANTILE)), 1e-6)


def _torque_Nm(robot: Robot, j: int, q: Array, acceleration: float, logged: Sequence[Array]) -> float:
    joint = robot.joints[j]
    if np.isfinite(joint.torque_limit_Nm):
        return joint.torque_limit_Nm
    data = mujoco.MjData(robot.model)
    largest = _high(logged) if logged else 0.0
    for angle in np.linspace(q.min(), q.max(), 9):
        data.qpos[joint.qpos_index] = angle
        mujoco.mj_forward(robot.model, data)
        inertia = np.zeros((robot.model.nv, robot.model.nv))
        mujoco.mj_fullM(robot.model, data, inertia)
        d = joint.dof_index
        largest = max(largest, float(abs(data.qfrc_bias[d]) + inertia[d, d] * acceleration))
    return max(largest, 1e-6)
