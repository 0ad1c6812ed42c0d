"""Friction of a joint."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Family, Fields, Size, State
from simgap.effects.joint import JointEffect
from simgap.robot import Robot

TINY_rad_s: Final = 1e-9
"""Stands for a speed of 0 as a divisor: no joint is seen to move that slowly."""


@dataclass(frozen=True, slots=True)
class ViscousFriction(JointEffect):
    """Damping beside that of the model."""

    name: ClassVar[str] = "viscous friction"
    family: ClassVar[Family] = Family.FRICTION

    @property
    def nominal(self) -> float:
        """Value of the model."""
        return self.scales.damping_Nms_rad

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Damping: at most what takes the whole torque at the highest speed, at least none at all."""
        scale = self.scales.torque_Nm / self.scales.speed_rad_s
        return (self.with_prior(Size("damping_Nms_rad", -self.scales.damping_Nms_rad, scale, 0.05 * scale)),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add to the damping."""
        fields.damping_Nms_rad[:, self.index] += size[:, 0]


@dataclass(frozen=True, slots=True)
class CoulombFriction(JointEffect):
    """Dry friction beside that of the model."""

    name: ClassVar[str] = "Coulomb friction"
    family: ClassVar[Family] = Family.FRICTION

    @property
    def nominal(self) -> float:
        """Value of the model."""
        return self.scales.frictionloss_Nm

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Friction: at most half of the torque, at least none at all."""
        scale = self.scales.torque_Nm
        return (self.with_prior(Size("coulomb_Nm", -self.scales.frictionloss_Nm, 0.5 * scale, 0.05 * scale)),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add to the dry friction."""
        fields.frictionloss_Nm[:, self.index] += size[:, 0]


@dataclass(frozen=True, slots=True)
class StribeckFriction(JointEffect):
    """Dry friction that falls from a value at rest as the joint moves."""

    name: ClassVar[str] = "Stribeck friction"
    family: ClassVar[Family] = Family.FRICTION
    has_shape: ClassVar[bool] = True

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Extra dry friction at rest, and the speed at which it has fallen to 1/e."""
        torque, speed = self.scales.torque_Nm, self.scales.speed_rad_s
        return (
            Size("stribeck_Nm", 0.0, 0.5 * torque, 0.05 * torque),
            Size("stribeck_rad_s", 0.0, speed, 0.1 * speed),
        )

    def friction_Nm(self, size: Array, state: State) -> Array:
        """Return the extra friction at the speed of the joint."""
        ratio = state.v_rad_s[:, self.index] / np.maximum(size[:, 1], TINY_rad_s)
        return np.asarray(size[:, 0] * np.exp(-ratio * ratio))


@dataclass(frozen=True, slots=True)
class LoadFriction(JointEffect):
    """Dry friction in proportion to the torque that the gear carries."""

    name: ClassVar[str] = "load-dependent friction"
    family: ClassVar[Family] = Family.FRICTION

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Friction per torque of the load; from 1 on no gear could be driven backwards."""
        return (Size("friction_per_load", 0.0, 1.0, 0.1),)

    def friction_Nm(self, size: Array, state: State) -> Array:
        """Return the friction under the load."""
        return np.asarray(size[:, 0] * np.abs(state.load_Nm[:, self.index]))


@dataclass(frozen=True, slots=True)
class AsymmetricFriction(JointEffect):
    """Dry friction in one direction only.

    It is dry friction of half its size and a constant torque of half its size against that direction.
    """

    name: ClassVar[str] = "asymmetric friction"
    family: ClassVar[Family] = Family.FRICTION
    is_steady: ClassVar[bool] = True

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Friction that acts on positive speeds alone; if it is negative, on negative speeds alone."""
        scale = self.scales.torque_Nm
        return (Size("asymmetric_Nm", -0.5 * scale, 0.5 * scale, 0.05 * scale),)

    def is_plausible(self, size: Array, others: Mapping[str, Array]) -> bool:
        """Return whether dry friction stays positive in both directions."""
        coulomb = others.get(CoulombFriction.name, np.zeros(1))
        return abs(float(size[0])) <= self.scales.frictionloss_Nm + float(coulomb[0])

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add the symmetric half."""
        fields.frictionloss_Nm[:, self.index] += 0.5 * np.abs(size[:, 0])

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the constant half."""
        return np.asarray(-0.5 * size[:, 0] + 0.0 * state.time_s)


@dataclass(frozen=True, slots=True)
class TemperatureFriction(JointEffect):
    """Dry friction that is larger when the joint is cold."""

    name: ClassVar[str] = "temperature-dependent friction"
    family: ClassVar[Family] = Family.FRICTION
    is_steady: ClassVar[bool] = True

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Friction per kelvin below the hottest logged temperature."""
        span_K = np.nan_to_num(self.scales.hottest_degC - self.scales.coldest_degC)
        scale = self.scales.torque_Nm / max(span_K, 1.0)
        return (Size("friction_Nm_K", 0.0, 0.5 * scale, 0.05 * scale),)

    def friction_Nm(self, size: Array, state: State) -> Array:
        """Return the extra friction at the temperature of the joint; none where it is not logged."""
        cold_K = np.nan_to_num(self.scales.hottest_degC - state.temperature_degC[:, self.index])
        return np.asarray(size[:, 0] * np.maximum(cold_K, 0.0))
