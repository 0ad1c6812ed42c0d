"""An effect drawn at random, as large as a campaign can see it: for thresholds and for blind cases alike."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.problem import Hypothesis, Parameter

LIMIT_MULTIPLES: Final = (0.5, 4.0)
"""Of the effects drawn, in detection limits."""
BOUND_SHARE: Final = 0.9
"""Share of the way to its bounds that a size drawn may go."""


@dataclass(frozen=True, slots=True)
class DetectableEffect:
    """An effect that can be drawn: its detection limit [typical sizes], and its class; none if outside."""

    hypothesis: Hypothesis
    limit: float
    label: int | None


@dataclass(frozen=True, slots=True, eq=False)
class SampledEffect:
    """One that was drawn, with the values of all its parameters, and its size over the limit."""

    source: DetectableEffect
    values: Array
    times_limit: float


def can_sample(one: DetectableEffect) -> bool:
    """Whether the campaign sees it, and its bounds leave room for the smallest size that is drawn."""
    return (
        bool(np.isfinite(one.limit))
        and max(_room(one, sign) for sign in (-1, 1)) >= LIMIT_MULTIPLES[0] * one.limit
    )


def sample_effect(some: Sequence[DetectableEffect], rng: np.random.Generator) -> DetectableEffect:
    """An effect first, then one of its places: an effect with many places is not drawn more often."""
    names = sorted({one.hypothesis.effect for one in some})
    name = names[int(rng.integers(len(names)))]
    places = [one for one in some if one.hypothesis.effect == name]
    return places[int(rng.integers(len(places)))]


def sample_amplitude(one: DetectableEffect, rng: np.random.Generator) -> SampledEffect:
    """All its sizes so many typical ones from neutral, to one side; within the bounds."""
    times = float(np.exp(rng.uniform(*np.log(LIMIT_MULTIPLES))))
    sign = int(rng.choice((-1, 1)))
    if _room(one, sign) < LIMIT_MULTIPLES[0] * one.limit:
        sign = -sign
    typical = min(times * one.limit, _room(one, sign))
    values = np.array(
        [p.absent + sign * typical * p.typical * p.is_amplitude for p in one.hypothesis.parameters]
    )
    return SampledEffect(one, values, typical / one.limit)


def _room(one: DetectableEffect, sign: int) -> float:
    """How many typical sizes all sizes together may go to one side."""
    return BOUND_SHARE * min(_parameter_room(parameter, sign) for parameter in one.hypothesis.amplitudes)


def _parameter_room(parameter: Parameter, sign: int) -> float:
    upwards = sign * parameter.typical > 0.0
    end = parameter.most if upwards else parameter.least
    return abs(end - parameter.absent) / abs(parameter.typical)
