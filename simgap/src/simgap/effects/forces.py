"""Torques at a joint: friction, springs, cables, counterbalances, offsets, and contact with a plane."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import (
    AddedNumber,
    Effect,
    Family,
    Fields,
    JointEffect,
    JointScales,
    Size,
    State,
)
from simgap.robot import Robot

TINY_rad_s: Final = 1e-9
"""Stands for a speed of 0 as a divisor: no joint is seen to move that slowly."""


@dataclass(frozen=True, slots=True)
class ViscousFriction(AddedNumber):
    """Damping beside that of the model."""

    name: ClassVar[str] = "viscous friction"
    family: ClassVar[Family] = Family.FRICTION
    number: ClassVar[str] = "damping_Nms_rad"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Damping: at most what takes the whole torque at the highest speed, at least none at all."""
        scale = self.scales.torque_Nm / self.scales.speed_rad_s
        return (self.size_of("damping_Nms_rad", -self.nominal, scale, 0.05 * scale),)


@dataclass(frozen=True, slots=True)
class CoulombFriction(AddedNumber):
    """Dry friction beside that of the model."""

    name: ClassVar[str] = "Coulomb friction"
    family: ClassVar[Family] = Family.FRICTION
    number: ClassVar[str] = "frictionloss_Nm"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Friction: at most half of the torque, at least none at all."""
        scale = self.scales.torque_Nm
        return (self.size_of("coulomb_Nm", -self.nominal, 0.5 * scale, 0.05 * scale),)


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
            self.size_of("stribeck_Nm", 0.0, 0.5 * torque, 0.05 * torque),
            self.size_of("stribeck_rad_s", 0.0, speed, 0.1 * speed),
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
        return (self.size_of("friction_per_load", 0.0, 1.0, 0.1),)

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
        return (self.size_of("asymmetric_Nm", -0.5 * scale, 0.5 * scale, 0.05 * scale),)

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
        return (self.size_of("friction_Nm_K", 0.0, 0.5 * scale, 0.05 * scale),)

    def friction_Nm(self, size: Array, state: State) -> Array:
        """Return the extra friction at the temperature of the joint; none where it is not logged."""
        cold_K = np.nan_to_num(self.scales.hottest_degC - state.temperature_degC[:, self.index])
        return np.asarray(size[:, 0] * np.maximum(cold_K, 0.0))


REACH: Final = 3.0
"""Largest torque over the usual one: a counterbalance may carry more than is left for the motor."""


@dataclass(frozen=True, slots=True)
class ConstantTorque(JointEffect):
    """A torque that never changes."""

    name: ClassVar[str] = "constant torque"
    family: ClassVar[Family] = Family.EXTERNAL
    is_steady: ClassVar[bool] = True

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Torque: at most half of that of the motor."""
        scale = self.scales.torque_Nm
        return (self.size_of("offset_Nm", -0.5 * scale, 0.5 * scale, 0.05 * scale),)

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the torque."""
        return np.asarray(size[:, 0] + 0.0 * state.time_s)


@dataclass(frozen=True, slots=True)
class Spring(JointEffect):
    """A spring between the links of a joint."""

    name: ClassVar[str] = "spring"
    family: ClassVar[Family] = Family.EXTERNAL

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Stiffness, with that of the model not negative, and torque in the middle of the range."""
        torque = self.scales.torque_Nm
        stiffness = torque / max(self.scales.high_rad - self.scales.low_rad, 1e-3)
        return (
            self.size_of("stiffness_Nm_rad", -self.scales.stiffness_Nm_rad, stiffness, 0.1 * stiffness),
            self.size_of("offset_Nm", -0.5 * torque, 0.5 * torque, 0.05 * torque),
        )

    @property
    def _middle_rad(self) -> float:
        return 0.5 * (self.scales.low_rad + self.scales.high_rad)

    def describe(self, size: Array) -> str:
        """Return the position at which the spring is slack too, which can be looked at."""
        slack = f" (slack at {self._middle_rad + size[1] / size[0]:.4g} {self.joint.unit})" if size[0] else ""
        return JointEffect.describe(self, size) + slack

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the torque of the spring."""
        return np.asarray(size[:, 1] - size[:, 0] * (state.q_rad[:, self.index] - self._middle_rad))


@dataclass(frozen=True, slots=True)
class PositionTorque(JointEffect):
    """A torque that depends smoothly on the angle, such as that of a counterbalance or of a cable."""

    name: ClassVar[str] = "position-dependent torque"
    family: ClassVar[Family] = Family.EXTERNAL

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Coefficients of cosine and sine of the angle.

        A counterbalance has the first order. A second one fits one range of angles better and fails in the
        next: on a KR300 it doubles the error in the batch that took no part.
        """
        scale = self.scales.torque_Nm
        low, high, typical = -REACH * scale, REACH * scale, 0.1 * scale
        return self.size_of("cos_Nm", low, high, typical), self.size_of("sin_Nm", low, high, typical)

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the sum of both waves."""
        q = state.q_rad[:, self.index]
        return np.asarray(size[:, 0] * np.cos(q) + size[:, 1] * np.sin(q))


@dataclass(frozen=True, slots=True)
class PeriodicTorque(JointEffect):
    """A torque with a number of periods in a turn: of teeth, of poles, of balls in a bearing."""

    name: ClassVar[str] = "periodic torque"
    family: ClassVar[Family] = Family.EXTERNAL
    order: float = 1.0
    """Periods in a turn of the joint."""

    @classmethod
    def of_order(cls, robot: Robot, place: str, scales: Mapping[str, JointScales], order: float) -> Self:
        """Return the effect of an order at a joint."""
        return replace(cls.at(robot, place, scales), order=order)

    @property
    def key(self) -> str:
        """Name with the order."""
        return f"{self.place}: {self.name} of order {self.order:g}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Coefficients of cosine and sine."""
        scale = self.scales.torque_Nm
        return tuple(
            self.size_of(f"{wave}_Nm", -0.5 * scale, 0.5 * scale, 0.02 * scale) for wave in ("cos", "sin")
        )

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the wave."""
        angle = self.order * state.q_rad[:, self.index]
        return np.asarray(size[:, 0] * np.cos(angle) + size[:, 1] * np.sin(angle))


PLANE: Final = "contact plane of the diagnosis"
TIP: Final = "contact tip of the diagnosis"
TIP_RADIUS_M: Final = 1e-3
"""The site touches, so the tip is a point; MuJoCo needs a radius, by which the plane is lowered."""
BIT: Final = 1 << 30
"""Collision bit of plane and tip, which no other geom has: neither touches anything else."""
NEVER_TOUCHED_M: Final = 1e3
"""Depth of the plane at size 0: more than a robot reaches."""


@dataclass(frozen=True, slots=True)
class PlaneContact(Effect):
    """Hard, frictionless horizontal plane that stops the tool site; the place is the site.

    MuJoCo realisation: a plane in the world and a small sphere at the site, which collide with each other
    only. The reference time of the contact is two time steps, the shortest that is stable.
    """

    name: ClassVar[str] = "contact with a plane"
    family: ClassVar[Family] = Family.CONTACT
    place: str
    lowest_m: float
    """Lowest height that the commanded motion reaches with the site."""
    high_m: float
    """Largest size: the measured motion was never lower than the plane."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Height of the plane above the lowest commanded height; 1 cm of lost motion is worth a name."""
        return (Size("above_lowest_m", 0.0, self.high_m, min(0.01, self.high_m)),)

    def describe(self, size: Array) -> str:
        """Return the height of the plane in the world."""
        return f"plane at z = {(self.lowest_m + float(size[0])) * 1e3:.1f} mm"

    def vary(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add plane and tip; the plane is out of reach."""
        site = spec.site(self.place)
        common = {"condim": 1, "priority": 1, "mass": 0.0, "solimp": (0.99, 0.99, 1e-3, 0.5, 2.0)}
        common["solref"] = (2 * robot.model.opt.timestep, 1.0)
        spec.worldbody.add_geom(
            name=PLANE,
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(1.0, 1.0, 1.0),
            pos=(0.0, 0.0, -NEVER_TOUCHED_M),
            contype=BIT,
            conaffinity=0,
            **common,
        )
        site.parent.add_geom(
            name=TIP,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(TIP_RADIUS_M, 0.0, 0.0),
            pos=site.pos,
            contype=0,
            conaffinity=BIT,
            **common,
        )

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Put the plane at its height."""
        rows = size[:, 0] != 0
        plane = fields.batch.model.geom(PLANE).id
        fields.batch.expand("geom_pos")[rows, plane, 2] = self.lowest_m + size[rows, 0] - TIP_RADIUS_M
