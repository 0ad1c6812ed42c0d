"""What may cause a gap (hypotheses), and what may differ without being its cause (nuisances)."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array

FACTOR: Final = "ln"
"""Unit of what is told as the logarithm of a factor."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect; ValueError if its neutral value is out of its bounds."""

    name: str
    unit: str
    least: float
    most: float
    typical: float
    """Departure from neutral, not 0; of a parameter without a neutral value, the value."""
    neutral: float | None = None
    """Where the effect changes nothing; None for a parameter that only shapes what the others bring about."""

    def __post_init__(self) -> None:
        if self.neutral is None:
            return
        if not self.least <= self.neutral <= self.most or self.typical == 0.0:
            raise ValueError(f"{self.name}: neutral must be within its bounds, and typical must not be 0")

    @property
    def sizes(self) -> bool:
        """Whether it says how large the effect is, not only what it is like."""
        return self.neutral is not None

    @property
    def unit_size(self) -> float:
        """What is counted in: its typical size, or 1 of a parameter that shapes and is 0 by default."""
        return abs(self.typical) or 1.0

    @property
    def absent(self) -> float:
        """Its value where the effect is absent: neutral, or the typical value of one that only shapes."""
        return self.typical if self.neutral is None else self.neutral


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """An effect at a place; ValueError if it has no parameter that says how large it is."""

    effect: str
    place: str
    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        if not any(parameter.sizes for parameter in self.parameters):
            raise ValueError(f"{self.name}: no parameter has a neutral value")

    @property
    def name(self) -> str:
        """As people are told it."""
        return f"{self.effect} at {self.place}"

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """The parameters that say how large it is: those that the race fits."""
        return tuple(parameter for parameter in self.parameters if parameter.sizes)

    @property
    def absent(self) -> Array:
        """Values of all parameters where the effect is absent."""
        return np.array([parameter.absent for parameter in self.parameters])

    def departures(self, values: Array) -> Array:
        """Of those that say how large it is, in typical sizes."""
        return np.array([
            (value - parameter.absent) / parameter.typical
            for value, parameter in zip(values, self.parameters, strict=True)
            if parameter.sizes
        ])  # fmt: skip


@dataclass(frozen=True, slots=True)
class Nuisance:
    """What calibration leaves uncertain, or what is drawn anew in every block; ValueError if sigma <= 0."""

    name: str
    unit: str
    sigma: float
    """About what is believed: infinite if nothing is known (not if drawn anew in every block)."""
    each_block: bool = False
    """Whether it is drawn anew, independently, in every block: scatter between repeats, not a constant."""

    def __post_init__(self) -> None:
        if not self.sigma > 0.0 or (self.each_block and self.sigma == float("inf")):
            raise ValueError(f"{self.name}: sigma must be above 0, and finite if it is drawn in every block")
