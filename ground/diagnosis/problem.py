"""What the diagnosis asks of a simulator: all that it ever sees of a robot."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array

INTERVAL_LEVEL: Final = 0.9
INTERVAL_QUANTILES: Final = ((1.0 - INTERVAL_LEVEL) / 2.0, (1.0 + INTERVAL_LEVEL) / 2.0)
"""Quantiles between which it lies."""


LOG_UNIT: Final = "ln"
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
    def is_amplitude(self) -> bool:
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
        if not any(parameter.is_amplitude for parameter in self.parameters):
            raise ValueError(f"{self.name}: no parameter has a neutral value")

    @property
    def name(self) -> str:
        """As people are told it."""
        return f"{self.effect} at {self.place}"

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        """The parameters that say how large it is: those that the race fits."""
        return tuple(parameter for parameter in self.parameters if parameter.is_amplitude)

    @property
    def absent(self) -> Array:
        """Values of all parameters where the effect is absent."""
        return np.array([parameter.absent for parameter in self.parameters])

    def departures(self, values: Array) -> Array:
        """Of those that say how large it is, in typical sizes."""
        return np.array([
            (value - parameter.absent) / parameter.typical
            for value, parameter in zip(values, self.parameters, strict=True)
            if parameter.is_amplitude
        ])  # fmt: skip


@dataclass(frozen=True, slots=True)
class Nuisance:
    """What calibration leaves uncertain, or what is drawn anew in every block; ValueError if sigma <= 0."""

    name: str
    unit: str
    sigma: float
    """About what is believed: infinite if nothing is known (not if drawn anew in every block)."""
    random_per_block: bool = False
    """Whether it is drawn anew, independently, in every block: scatter between repeats, not a constant."""

    def __post_init__(self) -> None:
        if not self.sigma > 0.0 or (self.random_per_block and self.sigma == float("inf")):
            raise ValueError(f"{self.name}: sigma must be above 0, and finite if it is drawn in every block")


Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class FeatureLayout:
    """What each of m features is; ValueError if the arrays do not agree or a number is not finite."""

    sigma: Array
    """Repeatability floor: one sigma of a feature between repeats, in its channel's unit, (m,)."""
    block: Ints
    """Which motion under which condition: the unit of cross-validation and of the bootstrap, (m,)."""
    channel: Ints
    """(m,)."""
    place: Ints
    """Where on the robot it was measured, (m,)."""
    regime: Ints
    """(m,)."""
    condition: Array
    """What a gap may depend on (temperature, load, speed, angle); 0 where it does not apply, (m, c)."""
    blocks: tuple[str, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    """Of the channels."""
    places: tuple[str, ...]
    regimes: tuple[str, ...]
    conditions: tuple[str, ...]

    def __post_init__(self) -> None:
        m = self.sigma.size
        if self.condition.shape != (m, len(self.conditions)):
            raise ValueError(f"condition is {self.condition.shape}; wanted {(m, len(self.conditions))}")
        if not (np.all(np.isfinite(self.condition)) and np.all(np.isfinite(self.sigma))):
            raise ValueError("sigma and condition must be finite")
        if not np.all(self.sigma > 0.0):
            raise ValueError("the floor of every feature must be above 0")
        if len(self.units) != len(self.channels):
            raise ValueError(f"{len(self.units)} units of {len(self.channels)} channels")
        for what, index, names in (
            ("block", self.block, self.blocks),
            ("channel", self.channel, self.channels),
            ("place", self.place, self.places),
            ("regime", self.regime, self.regimes),
        ):
            if index.shape != (m,):
                raise ValueError(f"{what} is {index.shape}; wanted {(m,)}")
            if m and not 0 <= index.min() <= index.max() < len(names):
                raise ValueError(f"{what} must be among its {len(names)} names")

    @property
    def size(self) -> int:
        """Number of features."""
        return self.sigma.size

    def select(self, rows: Ints) -> "FeatureLayout":
        """Some of the features, in that order; all names are kept."""
        arrays = ("sigma", "block", "channel", "place", "regime", "condition")
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What a log says of a campaign's features; ValueError if it does not fit the layout."""

    layout: FeatureLayout
    value: Array
    """Measured less what the nominal simulator predicts, in the units of the channels, (m,)."""

    def __post_init__(self) -> None:
        if self.value.shape != (self.layout.size,):
            raise ValueError(f"value is {self.value.shape}; wanted {(self.layout.size,)}")
        if not np.all(np.isfinite(self.value)):
            at = int(np.flatnonzero(~np.isfinite(self.value))[0])
            channel = self.layout.channels[self.layout.channel[at]]
            raise ValueError(f"feature {at} ({channel}) is not finite")


EffectValues = Mapping[Hypothesis, Array]
"""Values of all parameters of the effects that are there, in their order and units; absent if not named."""


class Simulator(Protocol):
    """A simulator bound to one campaign: to what its logs say was commanded, and where each motion began.

    The same arguments give the same numbers. A prediction depends on settings and nuisances only, never on
    what the logs measured in the features.
    """

    @property
    def layout(self) -> FeatureLayout:
        """The m features."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """What may be the cause, each once."""

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """What may differ without being the cause (q)."""

    def predict(self, settings: EffectValues, nuisance: Array) -> Array:
        """The features (m,) with these effects and these departures of the nuisances (q,), in their units.

        A nuisance that is drawn in every block departs equally in all of them here.
        """
