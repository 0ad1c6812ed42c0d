"""Diagnosis problem: parameters, hypotheses, nuisances, features, and the simulator interface.

A diagnosis compares m features (numbers derived from logs) with the prediction of a simulator. Near the
nominal state the residual (measured minus simulated) follows a linear model:

    y = N v + S a + e

Here y is the whitened residual, v the nuisances, a the amplitudes of the effects, and e noise of unit
variance. N and S are the sensitivities. The diagnosis finds the few hypotheses whose amplitudes are not 0.
These classes are all that the diagnosis knows about a robot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array

LOG_UNIT: Final = "ln"
"""Unit of a parameter that is the natural logarithm of a factor."""

Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter that sets the size of an effect."""

    name: str
    unit: str
    least: float
    most: float
    typical: float
    """Typical departure from neutral, not 0."""
    neutral: float
    """Value at which the effect changes nothing, within the bounds."""

    @property
    def departure_range(self) -> tuple[float, float]:
        """Least and greatest departure from neutral within the bounds, in typical sizes."""
        ends = [(end - self.neutral) / self.typical for end in (self.least, self.most)]
        return min(ends), max(ends)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Effect at a place; what sets its shape alone keeps the default of the catalogue."""

    effect: str
    place: str
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """Display name."""
        return f"{self.effect} at {self.place}"

    @property
    def key(self) -> str:
        """Name of its effect in the engine: `Effect.key`."""
        return f"{self.place}: {self.effect}"

    def departures(self, values: Array) -> Array:
        """Return the departures from neutral in typical sizes, shape (n,).

        Args:
            values: Values in their units, shape (n,).
        """
        typical, neutral = np.array([(one.typical, one.neutral) for one in self.parameters]).T
        return np.asarray((values - neutral) / typical)

    def values(self, departures: Array) -> Array:
        """Return the values in their units, shape (n,).

        Args:
            departures: Departures from neutral, without a unit (typical sizes), shape (n,).
        """
        typical, neutral = np.array([(one.typical, one.neutral) for one in self.parameters]).T
        return np.asarray(neutral + typical * departures)


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Uncertain parameter that is not a candidate cause.

    A shared nuisance has one value in all blocks: calibration leaves it uncertain. A random nuisance is drawn
    independently in every block: it makes repeats differ.
    """

    name: str
    unit: str
    sigma: float
    """Prior standard deviation."""
    random_per_block: bool = False
    """Random nuisance: drawn independently in every block."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureLayout:
    """Description of m features."""

    sigma: Array
    """Noise floor: standard deviation between repeats, in the unit of the channel, shape (m,)."""
    block: Ints
    """Index of the motion under one condition: the unit of the bootstrap, shape (m,)."""
    channel: Ints
    """Index of the measured quantity, shape (m,)."""
    place: Ints
    """Index of the location on the robot, shape (m,)."""
    regime: Ints
    """Index of the regime of motion, shape (m,)."""
    condition: Array
    """Conditions that a residual may depend on, such as temperature, load and speed, shape (m, c); 0 where a
    condition does not apply."""
    blocks: tuple[str, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    """Units of the channels."""
    places: tuple[str, ...]
    regimes: tuple[str, ...]
    conditions: tuple[str, ...]
    keys: tuple[str, ...] = ()
    """Keys of the m features, equal in every log of a session: session, motion, channel, number."""

    @property
    def size(self) -> int:
        """Number of features."""
        return self.sigma.size

    def select(self, rows: Ints) -> "FeatureLayout":
        """Return the layout of some features, in the order of `rows`; all names stay."""
        arrays = ("sigma", "block", "channel", "place", "regime", "condition")
        keys = tuple(self.keys[row] for row in rows) if self.keys else ()
        return replace(self, keys=keys, **{name: getattr(self, name)[rows] for name in arrays})


EffectValues = Mapping[Hypothesis, Array]
"""Values of the parameters of the effects that are switched on, in their order and units."""

Simulate = Callable[[EffectValues], Array]
"""Simulator of a case: the change of its m features by effects, in the units of the channels, shape (m,); NaN
if no such robot can be simulated. It never depends on the measured features."""
