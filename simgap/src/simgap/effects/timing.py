"""Errors of sensors: time stamps, scale and zero of encoders."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Family, Size
from simgap.effects.joint import JointEffect


@dataclass(frozen=True, slots=True)
class MeasurementDelay(JointEffect):
    """Positions are older than their time stamps say.

    The delay of one joint is a skew between joints. It does not depend on the simulation.
    """

    name: ClassVar[str] = "measurement delay"
    family: ClassVar[Family] = Family.TIMING

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Delay; negative if samples are younger than their stamps."""
        return (Size("delay_s", -0.1, 0.1, 0.01),)

    def sample_delay_s(self, size: Array) -> Array:
        """Return the delay."""
        return np.asarray(size[:, 0])


@dataclass(frozen=True, slots=True)
class EncoderScale(JointEffect):
    """The encoder shows an angle that is too large in proportion."""

    name: ClassVar[str] = "encoder scale"
    family: ClassVar[Family] = Family.TIMING

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Relative error; a tenth is already another gear."""
        return (Size("scale_ratio", -0.1, 0.1, 0.01),)

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Scale the angle."""
        return np.asarray(q_rad * (1.0 + size[:, :1]))

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Scale it back."""
        return np.asarray(shown_rad / (1.0 + size[:, :1]))


@dataclass(frozen=True, slots=True)
class JointZero(JointEffect):
    """The encoder shows an angle with a constant error."""

    name: ClassVar[str] = "joint zero"
    family: ClassVar[Family] = Family.GEOMETRY

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Angle that the encoder shows at the zero of the model; 10 degrees are seen by the eye."""
        return (Size("zero_rad", -0.175, 0.175, 0.02),)

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Add the error."""
        return np.asarray(q_rad + size[:, :1])

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Subtract it."""
        return np.asarray(shown_rad - size[:, :1])
