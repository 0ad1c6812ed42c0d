"""Diagnosis problem: parameters, hypotheses, nuisances, features, and the sensitivities of a simulator.

A diagnosis compares m features (numbers derived from logs) with the prediction of a simulator. Near the
nominal state the residual (measured minus simulated) follows a linear model:

    y = N v + S a + e

Here y is the whitened residual, v the nuisances, a the amplitudes of the effects, and e noise of unit
variance. N and S are the sensitivities, which are computed once for a campaign, and cached. The diagnosis
finds the few hypotheses whose amplitudes are not 0.

In all functions, features and their changes are arrays (m,) in the units of their channels. Departures are
from neutral, without a unit (typical sizes), (k,).
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array
from sim.effects.catalogue import EffectHypothesis
from sim.effects.effect import Effect as PlantEffect
from simgap import Effect, Size
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write

LOG_UNIT: Final = "ln"
"""Unit of a parameter that is the natural logarithm of a factor."""
_READ_ERRORS: Final = (OSError, EOFError, BadZipFile, zlib.error, RuntimeError, ValueError, KeyError)
"""Errors of a damaged archive; zipfile raises RuntimeError for unknown compression."""
BOUND_SHARE: Final = 0.9
"""Largest share of the way to a bound at which a fit starts, or a random effect is."""
ROUNDING: Final = 1e-9
"""Greatest relative difference of two columns that come from the same simulated change."""

CONDITIONS: Final = (
    *("temperature", "load", "speed", "sine of the angle", "cosine of the angle", "direction"),
)
"""Conditions of a feature: degC, N m, rad/s, and the last three without a unit."""

Ints = NDArray[np.intp]
Texts = NDArray[np.str_]


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
class Hypothesis(Effect):
    """Effect at a place; its sizes are departures from neutral in typical sizes.

    What sets its shape alone keeps the default of the catalogue.
    """

    name: str = field()  # a field, as the base has a property of this name
    place: str
    parameters: tuple[Parameter, ...]
    family: StrEnum = field()
    location: str
    """Place without axis or direction."""
    entry: EffectHypothesis | None = field(default=None, compare=False)
    """Entry of the catalogue, which makes the effect of the plant."""
    start: float = field(default=1.0, compare=False)
    """Departure in typical sizes from which a fit starts, if the bounds leave room."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Amplitudes."""
        ranges = [(one.name, *one.departure_range) for one in self.parameters]
        return tuple(
            Size(name, least, most, min(self.start, BOUND_SHARE * (most or -least)))
            for name, least, most in ranges
        )

    @property
    def common_range(self) -> tuple[float, float]:
        """Least and greatest departure of all amplitudes together, in typical sizes."""
        least, most = zip(*(one.departure_range for one in self.parameters), strict=True)
        return max(least), min(most)

    def values(self, departures: Array) -> Array:
        """Return the values of the parameters in their units, (k,)."""
        typical, neutral = np.array([(one.typical, one.neutral) for one in self.parameters]).T
        return np.asarray(neutral + typical * departures)

    def name_sizes(self, size: Array) -> dict[str, float]:
        """Return the values of the parameters by their names; of a factor, the logarithm."""
        names = [f"ln_{one.name}" if one.unit == LOG_UNIT else one.name for one in self.parameters]
        return dict(zip(names, self.values(size).tolist(), strict=True))

    def describe(self, size: Array) -> str:
        """Return departures in the units of the parameters; a factor as its change in percent."""
        return ", ".join(
            f"{one.name} {100.0 * np.expm1(value):+.3g} %"
            if one.unit == LOG_UNIT
            else f"{one.name} = {value:.4g}"
            for one, value in zip(self.parameters, self.values(size), strict=True)
        )

    def switch_on(self, departures: Array) -> PlantEffect:
        """Return the effect of the plant; a factor is given by its logarithm."""
        assert self.entry is not None, "a hypothesis of the catalogue"
        values: dict[str, float] = {}
        for one, value in zip(self.parameters, self.values(departures).tolist(), strict=True):
            inside = min(max(value, one.least), one.most)  # also by the last bit
            values[one.name] = float(np.exp(inside)) if one.unit == LOG_UNIT else inside
        return self.entry.effect(**values)


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
    effect: Callable[[float], PlantEffect] | None = None
    """Makes the effect of the plant from a departure."""
    same_as: str = ""
    """Key of the hypothesis, or name of the nuisance, that equals it for small departures."""
    only_channel: str = ""
    """Channel of the only features that a numerical error, on or off, influences; empty for all others."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureLayout:
    """Description of m features; texts and numbers of shape (m,)."""

    sigma: Array
    """Noise floor: standard deviation between repeats, in the unit of the channel."""
    block: Texts
    """Motion under one condition: the unit of the bootstrap."""
    channel: Texts
    """Measured quantity with its place."""
    unit: Texts
    regime: Texts
    """Regime of motion."""
    condition: Array
    """CONDITIONS that a residual may depend on, shape (m, 6); 0 where a condition does not apply."""
    time_s: Array
    """Time since the start of its log; 0 for what is of a whole log."""
    key: Texts
    """Name that is equal in every log of a session: session, motion, channel, number."""

    @property
    def size(self) -> int:
        """Number of features."""
        return self.sigma.size

    def select(self, rows: Ints) -> "FeatureLayout":
        """Return the layout of some features, in the order of `rows`."""
        return replace(self, **{one.name: getattr(self, one.name)[rows] for one in fields(self)})


Departures = Mapping[Hypothesis, Array]
"""Departures from neutral, in typical sizes, of the effects that are switched on."""

Simulate = Callable[[Departures], Array]
"""Simulator of a case: the change of its m features by effects, in the units of the channels, shape (m,); NaN
if no such robot can be simulated. It never depends on the measured features."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """First and second derivatives of the simulator f at its nominal state.

    With amplitudes a in typical sizes, f(a, v) = f(0, 0) + S a + Q a^2 + N v, the square taken of each.
    """

    layout: FeatureLayout
    hypotheses: tuple[Hypothesis, ...]
    nuisances: tuple[Nuisance, ...]
    effect: Array
    """Change per typical size of each amplitude parameter, in the order of `owner`, shape (m, k)."""
    curve: Array
    """Change per squared typical size: parabola through nominal and the simulated steps, shape (m, k)."""
    reach: Array
    """Largest simulated departure in typical sizes, shape (k,)."""
    owner: Ints
    """Index of the hypothesis that each column belongs to, ascending, shape (k,)."""
    nuisance: Array
    """Change per unit of each nuisance, shape (m, q)."""

    def __post_init__(self) -> None:
        if not all(np.all(np.isfinite(one)) for one in (self.effect, self.curve, self.reach, self.nuisance)):
            raise ValueError("sensitivities must be finite")

    @property
    def shared_nuisances(self) -> list[int]:
        """Indices of the nuisances with one value in all blocks."""
        return [index for index, nuisance in enumerate(self.nuisances) if not nuisance.random_per_block]

    @property
    def sigma(self) -> Array:
        """Prior standard deviation of each nuisance in its own unit, shape (q,)."""
        return np.array([one.sigma for one in self.nuisances])

    def index(self, key: str) -> int:
        """Return the index of the hypothesis with this key."""
        return next(k for k, one in enumerate(self.hypotheses) if one.key == key)

    def change(self, departures: Departures) -> Array:
        """Compute the change (m,) by effects: parabolas, linear beyond the simulated departures."""
        total = np.zeros(self.layout.size)
        for hypothesis, a in departures.items():
            own = self.owner == self.hypotheses.index(hypothesis)
            total += continue_parabola(self.effect[:, own], self.curve[:, own], self.reach[own], a)
        return total

    def with_simulated(self, hypothesis: int, a: Array, change: Array) -> "Sensitivities":
        """Return the sensitivities with the parabola of one hypothesis through a simulated change.

        The slopes stay. The curvature of its largest amplitude takes what they miss. A nuisance of the same
        parameter, whose column is parallel, gets the slope of the parabola there. The departures `a` are not
        all 0.
        """
        columns = np.flatnonzero(self.owner == hypothesis)
        curve, reach = self.curve.copy(), self.reach.copy()
        reach[columns] = np.maximum(reach[columns], np.abs(a))
        largest = int(np.argmax(np.abs(a)))
        curve[:, columns[largest]] = 0.0
        missed = change - self.effect[:, columns] @ a - curve[:, columns] @ a**2
        curve[:, columns[largest]] = missed / a[largest] ** 2
        slope = self.effect[:, columns[largest]]
        turn = 2.0 * curve[:, columns[largest]] * a[largest]
        shares = slope @ self.nuisance / max(float(slope @ slope), float(np.finfo(float).tiny))
        beside = np.abs(self.nuisance - np.outer(slope, shares)).max(axis=0)
        is_parallel = beside <= ROUNDING * np.abs(self.nuisance).max(axis=0)
        nuisance = self.nuisance + np.outer(turn, np.where(is_parallel, shares, 0.0))
        return replace(self, curve=curve, reach=reach, nuisance=nuisance)

    def linearised(self, hypothesis: int, a: Array) -> "Sensitivities":
        """Return the sensitivities with those of one hypothesis linearised at an estimate.

        The column of its largest amplitude makes the whole change there, beside the slopes of the others. The
        departures `a` are not all 0.
        """
        columns = np.flatnonzero(self.owner == hypothesis)
        inside = np.clip(a, -self.reach[columns], self.reach[columns])
        effect, curve = self.effect.copy(), self.curve.copy()
        change = self.change({self.hypotheses[hypothesis]: a})
        effect[:, columns] += 2.0 * curve[:, columns] * inside
        largest = int(np.argmax(np.abs(a)))
        others = np.delete(np.arange(columns.size), largest)
        effect[:, columns[largest]] = (change - effect[:, columns[others]] @ a[others]) / a[largest]
        curve[:, columns] = 0.0
        return replace(self, effect=effect, curve=curve)

    def select(self, rows: Ints) -> "Sensitivities":
        """Return the sensitivities of some features, in that order."""
        arrays = ("effect", "curve", "nuisance")
        return replace(
            self, layout=self.layout.select(rows), **{name: getattr(self, name)[rows] for name in arrays}
        )


_ARRAYS: Final = ("effect", "curve", "reach", "owner", "nuisance")
"""Arrays of sensitivities beside those of their layout."""


def save_sensitivities(path: Path, found: Sensitivities) -> None:
    """Save sensitivities, without what they are of, to an .npz file; BadOutput if it cannot be written."""
    arrays = {one.name: getattr(found.layout, one.name) for one in fields(FeatureLayout)}
    with atomic_write(path, "sensitivities") as file:
        np.savez(file, **arrays, **{name: getattr(found, name) for name in _ARRAYS})


def load_sensitivities(
    path: Path, hypotheses: Sequence[Hypothesis], nuisances: Sequence[Nuisance]
) -> Sensitivities:
    """Load sensitivities to these hypotheses and nuisances, with which they were saved.

    BadRequest if the file is incomplete, damaged, or holds something else.
    """
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            layout = FeatureLayout(**{one.name: file[one.name] for one in fields(FeatureLayout)})
            arrays = {name: file[name] for name in _ARRAYS}
            return Sensitivities(layout, tuple(hypotheses), tuple(nuisances), **arrays)
    except _READ_ERRORS as error:
        raise BadRequest(
            f"{path}: no sensitivities ({error}); remove it, and they are computed anew"
        ) from error


def continue_parabola(effect: Array, curve: Array, reach: Array, a: Array) -> Array:
    """Compute changes: parabolas up to their reach, and straight on beyond.

    Columns are as in `Sensitivities`. Departures `a` may be those of n candidates, (n, k); changes then are
    (n, m).
    """
    inside = np.clip(a, -reach, reach)
    return np.asarray(a @ effect.T + (inside * (2.0 * a - inside)) @ curve.T)


def fit_parabola(ends: Sequence[tuple[Array, float]]) -> tuple[Array, Array]:
    """Fit slope and curvature (m,) at 0 through 0 and one or two changes with their steps; one is a line."""
    (high, up), (low, down) = ends[0], ends[-1]
    curvature = np.zeros_like(high) if up == down else (high / up - low / down) / (up - down)
    return high / up - curvature * up, curvature
