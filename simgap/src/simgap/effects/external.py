"""Torques at a joint that are not in the model: springs, cables, counterbalances, offsets."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Family, Size, State
from simgap.effects.joint import JointEffect, JointScales
from simgap.robot import Robot

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
        return (Size("offset_Nm", -0.5 * scale, 0.5 * scale, 0.05 * scale),)

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
        """Stiffness, negative for a toggle, and torque in the middle of the range."""
        torque = self.scales.torque_Nm
        stiffness = torque / max(self.scales.high_rad - self.scales.low_rad, 1e-3)
        return (
            Size("stiffness_Nm_rad", -stiffness, stiffness, 0.1 * stiffness),
            Size("offset_Nm", -0.5 * torque, 0.5 * torque, 0.05 * torque),
        )

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the torque of the spring."""
        middle = 0.5 * (self.scales.low_rad + self.scales.high_rad)
        return np.asarray(size[:, 1] - size[:, 0] * (state.q_rad[:, self.index] - middle))


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
        return Size("cos_Nm", low, high, typical), Size("sin_Nm", low, high, typical)

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
        """Return the effect of an order at a joint.

        Args:
            place: Name of the joint.
            scales: Numbers of all joints.
            order: Periods in a turn of the joint.
        """
        return replace(cls.at(robot, place, scales), order=order)

    @property
    def key(self) -> str:
        """Name with the order."""
        return f"{self.place}: {self.name} of order {self.order:g}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Coefficients of cosine and sine."""
        scale = self.scales.torque_Nm
        return tuple(Size(f"{wave}_Nm", -0.5 * scale, 0.5 * scale, 0.02 * scale) for wave in ("cos", "sin"))

    def torque_Nm(self, size: Array, state: State) -> Array:
        """Return the wave."""
        angle = self.order * state.q_rad[:, self.index]
        return np.asarray(size[:, 0] * np.cos(angle) + size[:, 1] * np.sin(angle))
