"""The interface of an effect: a place, sizes, and what it changes.

An effect overrides only the hooks that it needs. Every hook gets its sizes for many simulations at once,
(n_sims, n_sizes). A size of 0 leaves every bit as it was: the effect is absent. Sizes are therefore chosen so
that 0 means absence: a velocity limit has the size 1/limit.

Hooks by kind of residual:
- simulation: `vary`, `set_model`, `shape_command`, `act`, `friction_Nm`, `torque_Nm`, `encode`, `decode`,
  `sample_delay_s`;
- inverse dynamics: `set_model`, `friction_Nm`, `torque_Nm` and `encode`, at the measured motion;
- second encoder: `deflection_rad`, `sample_delay_s` and `encode`.
"""

import math
from abc import ABC
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import mujoco
import mujoco.batch

from diagnosis.arrays import Array
from diagnosis.robot import Robot


class Family(StrEnum):
    """Kinds of effects, the middle level of a verdict."""

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
    """Standard deviation of its prior around 0; infinite for an effect that may be named."""


@dataclass(frozen=True, slots=True)
class State:
    """Motion at one instant of many simulations, (n_sims, n_joints), or at many samples, (n, n_joints)."""

    time_s: Array
    """(n_sims,) or (n,)."""
    q_rad: Array
    v_rad_s: Array
    load_Nm: Array
    """Torque that the gear carries, without friction: gravity and inertia."""
    temperature_degC: Array
    """(n_sims, n_joints); NaN where it is not logged."""


@dataclass(slots=True)
class Fields:
    """Numbers of the model and of the controllers, a row a simulation; `set_model` changes them."""

    kp_Nm_rad: Array
    """(n_sims, n_joints)."""
    kd_Nms_rad: Array
    torque_limit_Nm: Array
    damping_Nms_rad: Array
    frictionloss_Nm: Array
    armature_kgm2: Array
    batch: mujoco.batch.Batch
    """For all other fields: `batch.expand(name)`; the engine calls `set_const` once after all effects."""


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
    period_s: float
    memory: dict[str, Array]
    """State of the effect of its own, kept from tick to tick."""


class Effect(ABC):
    """A physical cause of a difference between a robot and its model.

    Subclasses are frozen dataclasses with the fields `place` and whatever they need to know of the robot.
    """

    name: ClassVar[str]
    """Standard term, such as "Coulomb friction"."""
    family: ClassVar[Family]
    place: str
    """Name of the joint, or of the body."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Numbers of the effect; all 0: absent."""
        raise NotImplementedError

    @property
    def key(self) -> str:
        """Name that is unique in a catalogue."""
        return f"{self.place}: {self.name}"

    def describe(self, size: Array) -> str:
        """Return the sizes, (n_sizes,), as text with units, in the form that a user expects."""
        return ", ".join(f"{one.name} = {value:.4g}" for one, value in zip(self.sizes, size, strict=True))

    def shape_command(self, size: Array, command: Array, period_s: float) -> Array:
        """Return the command of this joint as it arrives, (n_sims, n_ticks), given as (n_sims, n_ticks)."""
        return command

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
        """Return how much later than its time stamp says the position of this joint is old, (n_sims,) [s]."""
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

    def overrides(self, hook: str) -> bool:
        """Return whether this effect has its own version of a hook."""
        return getattr(type(self), hook) is not getattr(Effect, hook)
